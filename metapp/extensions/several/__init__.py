"""Several flash photos of one flat material, with the places of camera and flash: their format and their recipe."""
