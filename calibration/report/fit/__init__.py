"""The report of a fit: page, pictures, numbers and words."""
