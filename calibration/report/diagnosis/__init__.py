"""The report of a diagnosis: page, pictures, numbers, sets, and the words that all of them use."""
