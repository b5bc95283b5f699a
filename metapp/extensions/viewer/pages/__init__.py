"""The pages of the applications that ship, each offered to the door as a `Page`."""
