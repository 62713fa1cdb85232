"""The command `pmfid explain`: what a key of AXIS.toml or a word of a status means."""

from __future__ import annotations

import click

from pmfid.cli.options import JSON


@click.command(short_help="Say what a key of AXIS.toml or a status means.")
@click.argument("key", nargs=-1)
@click.option("--page", "as_page", is_flag=True, help="Print the page of all keys, in Markdown.")
@JSON
def explain(key: tuple[str, ...], as_page: bool, as_json: bool) -> None:
    """Say what KEY means: a key of AXIS.toml as record.time_unit, a section of it, or a word of a status as
    poor_excitation. Without KEY all of them, a line for each.
    """
    from pmfid.session.reference import entries, explained, find, page

    if as_page:
        click.echo(page(), nl=False)
        return
    found = find(" ".join(key)) if key else entries()
    if as_json:
        from pmfid.cli.output import print_json

        print_json({"entries": [entry.to_json() for entry in found]})
    else:
        click.echo(explained(found))
