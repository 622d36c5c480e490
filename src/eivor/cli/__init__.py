"""The command line: arguments to calls, results to the terminal, errors to exit codes."""
