"""Reports: tables, pages and plots of what the model and the fit found; nothing here computes a result."""
