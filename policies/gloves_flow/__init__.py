"""What every policy built on a flow shares: its settings, its training and sampling, and what it binds as an adapter.

A package below the plugins that stand on it. It registers nothing, so its name does not have the prefix of a plugin.
"""
