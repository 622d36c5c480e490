"""Example flight and the table of public logs."""
