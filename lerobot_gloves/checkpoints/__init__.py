"""What a saved policy is: its configuration, processors and calibration, and whether two of them fit."""
