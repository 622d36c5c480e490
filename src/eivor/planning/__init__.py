"""Planning of identification flights."""
