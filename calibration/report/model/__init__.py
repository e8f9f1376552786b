"""Reports of the model alone: a simulation, and the article's results beside ours."""
