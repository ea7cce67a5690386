"""The policy type `gloves_person`: a person's command, held."""
