"""`python -m eivor`: the command line of this interpreter, where the console script is not on the path."""

from eivor.cli.entry import run

if __name__ == "__main__":
    run()
