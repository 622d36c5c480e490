"""What the recipe's choices rest on, measured."""
