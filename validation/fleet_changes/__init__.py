"""What fleet reports say of vehicles that change, and of those that do not, where the truth is known."""
