"""The pages of the applications that ship, each an entry of `registry.pages`."""
