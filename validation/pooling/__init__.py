"""What pooling does where the truth is known: coverage of a vehicle's mean and of its next flight."""
