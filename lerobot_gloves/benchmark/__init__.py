"""The benchmark: perturbation x method x seed on a task, paired by episode."""
