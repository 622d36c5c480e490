"""Fractional difference equations against analytic truth: records, and the study of their estimates."""
