"""What physics a recording shows that the model leaves out, a file a step."""
