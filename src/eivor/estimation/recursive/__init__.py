"""Estimates that follow a stream of samples and forget what lies far back, and the changes they meet."""
