"""Reports of results: tables, flight cards, JSON documents and figures."""
