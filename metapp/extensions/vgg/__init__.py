"""ImageNet weights of VGG-16, which losses on pictures read: found or fetched, once.

Read `weights`, where weights come from and how they are checked; then `vgg_command`, the command.
"""
