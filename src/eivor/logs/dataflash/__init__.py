"""ArduPilot DataFlash logs."""
