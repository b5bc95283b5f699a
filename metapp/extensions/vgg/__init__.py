"""ImageNet weights of VGG-16, which losses on pictures read: found or fetched, once."""

from metapp.door import Command

OFFERS = (Command("vgg", "metapp.extensions.vgg.commands:vgg", under="data"),)
