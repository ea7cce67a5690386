"""Rows to statistics, tables, plots and pages; stands on the benchmark's rows alone."""
