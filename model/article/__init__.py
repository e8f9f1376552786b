"""The article's results computed anew, beside the printed ones."""
