"""The report of a diagnosis of a machine that is not the article's motor: page, picture, words."""
