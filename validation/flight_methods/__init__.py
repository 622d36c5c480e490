"""Methods side by side on simulated flights of one vehicle, its actuators' lag searched for and left out."""
