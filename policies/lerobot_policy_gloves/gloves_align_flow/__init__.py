"""The align flow: expert flow and agent flow in one network, told apart by a label of the source."""
