"""What every room needs of the machine: files written whole, locks, processes, errors on one line."""
