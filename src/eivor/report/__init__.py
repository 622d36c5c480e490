"""Reports: documents, figures, pages and JSON."""
