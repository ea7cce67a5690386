"""What every policy built on a flow shares: its settings, its training and its sampling."""
