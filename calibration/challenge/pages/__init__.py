"""Tables, pictures and the page of a campaign or of a record."""
