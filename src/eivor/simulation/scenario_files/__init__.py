"""Scenarios in TOML files, those that ship among them."""
