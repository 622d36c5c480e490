"""Local web page for logs."""
