"""How rows are weighted, and how equations are: two axes of a linear method."""
