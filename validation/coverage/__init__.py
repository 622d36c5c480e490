"""The study of coverage: intervals of every method over eleven scenarios."""
