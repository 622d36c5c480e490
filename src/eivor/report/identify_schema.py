"""The name of the documents that `identify` writes and others read."""

SCHEMA = "eivor.identify/1"
