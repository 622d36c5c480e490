"""What Eivor proves of itself: it stands beside the package and is no part of what is installed."""
