"""A plan as files: a table, and programs and missions for those who fly it. Their inputs are numbers only."""
