"""Files that come with the package: the example flight and its truth."""
