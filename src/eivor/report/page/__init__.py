"""Documents as a page of HTML: one file that opens anywhere, without a network."""
