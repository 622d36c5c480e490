"""The parity record: numbers of one state of the code beside those of another."""
