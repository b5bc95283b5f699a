"""Interactive HTML pages of fits, and pages that follow fits while they run."""

from metapp.door import Command, Option, Watcher

OFFERS = (
    Command("view", "metapp.cli.view:command"),
    Command("try", "metapp.cli.trial:command"),
    Watcher(
        Option("watch", False, "Show the fit while it runs: update watch.png and serve a page.", panel="Output"),
        "metapp.runs.watching:Watched",
    ),
)
