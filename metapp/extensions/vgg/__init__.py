"""ImageNet weights of VGG-16, which losses on pictures read: found or fetched, once."""

from metapp.registry import Entry, Registry


def register(registry: Registry) -> None:
    """Add the command."""
    registry.commands["data vgg"] = Entry("metapp.extensions.vgg.commands:vgg")
