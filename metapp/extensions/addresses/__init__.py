"""Inputs at addresses of object stores and servers, and runs kept there, by fsspec."""

from metapp.door import Addresses

OFFERS = (Addresses("metapp.extensions.addresses.access"),)
