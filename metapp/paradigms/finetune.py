"""Finetune: General's result, then Adam for about a tenth of Overfit's steps."""

from metapp.learning.learn import MetaParameters
from metapp.learning.recipe import Adam
from metapp.paradigms.general import General


class Finetune(General):
    """Adam from General's prediction."""

    name = "finetune"

    @property
    def recipe_steps(self) -> int:
        """Finetune's."""
        return self.recipe.finetune_steps

    def adam(self, phi: MetaParameters) -> Adam:
        """The recipe's, for Finetune."""
        return self.recipe.finetune
