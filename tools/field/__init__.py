"""The product in a machine of its own: a real kernel, a real service manager, buses, unplugged adapters, cut power."""
