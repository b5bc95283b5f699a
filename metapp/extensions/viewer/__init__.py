"""Interactive HTML pages of fits, which need no network and no server.

Read `view`, the content of a page for one fit; `pages`, views of the applications that ship; `viewer_page`, the HTML
file; then `runs_page`, pages of runs, and `viewer_commands`, the commands.
"""
