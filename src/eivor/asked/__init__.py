"""What people ask for in words, on the command line or in the page, as what the library takes."""
