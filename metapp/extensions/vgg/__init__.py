"""ImageNet weights of VGG-16, which losses on pictures read: found or fetched, once."""
