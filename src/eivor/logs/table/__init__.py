"""Tables: delimited text and Parquet."""
