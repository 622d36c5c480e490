"""Exports of results for autopilots and simulators."""
