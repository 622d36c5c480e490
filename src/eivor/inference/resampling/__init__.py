"""Resampling: blocks of a record, and what replicates say."""
