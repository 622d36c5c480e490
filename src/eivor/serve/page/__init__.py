"""The page of `eivor serve`: one file, whose script asks the server for everything else."""
