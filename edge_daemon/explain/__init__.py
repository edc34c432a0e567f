"""Compare the model with measurements, name what is missing, plan the next experiment. Pure."""
