"""What recursive identification does on records with known truth: false alarms, delays, intervals."""
