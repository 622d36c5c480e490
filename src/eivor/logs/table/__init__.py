"""Tables: CSV, Parquet, HDF5 and MATLAB files."""
