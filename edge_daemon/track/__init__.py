"""The same model followed live: recursive estimates with a standard deviation and a status. Pure."""
