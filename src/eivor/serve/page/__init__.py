"""The page, as it is sent to the browser."""
