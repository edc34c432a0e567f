"""Files that other machines recorded become columns under the names of the channels. Pure but for reading them."""
