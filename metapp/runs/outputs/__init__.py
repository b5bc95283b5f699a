"""Files of fits: `contact_sheet` draws rows of pictures, `fit_files` writes pictures and exports of one fit."""
