"""The study of logs as real loggers make them: flights, loggers, trials, requirements and page."""
