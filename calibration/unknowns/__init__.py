"""Every unknown of a fit and of a diagnosis, and its prior."""
