"""Pages that are written by what they describe: OpenAPI, the .proto files, the command line, materials, model cards.

MkDocs calls the `on_…` functions; everything else turns a source of truth into Markdown and can be tested alone.
"""

from __future__ import annotations

import argparse
import logging
import posixpath
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

OUTSIDE = "outside"
"""Where files of the repository that pages show lie on the site."""

# --- what MkDocs calls ------------------------------------------------------------------------------------------------


def on_files(files: Any, config: Any) -> Any:
    """Add the generated pages, and the images that pages show from elsewhere in the repository."""
    from mkdocs.structure.files import File

    pages = {
        "reference/http-api.md": http_reference(),
        "reference/grpc-api.md": grpc_reference((ROOT / "proto/physnet/v1/deformation.proto").read_text("utf-8")),
        "reference/command-line.md": command_reference(),
        "model-card.md": model_cards(ROOT / "models"),
        "changelog.md": (ROOT / "CHANGELOG.md").read_text("utf-8"),
    }
    for path, text in pages.items():
        files.append(File.generated(config, path, content=text))
    shown = {image for path in Path(config["docs_dir"]).rglob("*.md") for image in _outside_images(path)}
    for image in sorted(shown):
        files.append(File.generated(config, f"{OUTSIDE}/{image}", abs_src_path=str(ROOT / image)))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Put in tables, and let links that leave the site say where they lead."""
    markdown = markdown.replace("<!-- materials -->", materials_table())
    return leave_site(markdown, page.file.src_uri)


def on_post_page(output: str, page: Any, **_: Any) -> None:
    """A page that loads something from elsewhere is a warning, and so an error: robots have no internet."""
    for address in loaded_from_elsewhere(output):
        logging.getLogger("mkdocs.hooks.reference").warning("%s loads %s", page.file.src_uri, address)


def loaded_from_elsewhere(html: str) -> list[str]:
    """Addresses of scripts, images, frames and styles of other hosts; links to read are none."""
    sources = re.findall(r'<(?:script|img|iframe)\b[^>]*\bsrc="((?:https?:)?//[^"]*)"', html)
    links = [link for link in re.findall(r"<link\b[^>]*>", html) if 'rel="canonical"' not in link]
    return sources + re.findall(r'href="((?:https?:)?//[^"]*)"', "".join(links))


def leave_site(markdown: str, page: str) -> str:
    """Links out of docs/ as plain paths of the repository, which a page on the web cannot follow; images stay."""

    def rewrite(found: re.Match[str]) -> str:
        bang, text, target = found.groups()
        path = posixpath.normpath(posixpath.join("docs", posixpath.dirname(page), target.partition("#")[0]))
        if path.startswith("docs/"):
            return found[0]
        if bang:
            return f"![{text}]({posixpath.relpath(f'{OUTSIDE}/{path}', posixpath.dirname(page) or '.')})"
        return f"{text} (`{path}`)" if text.strip("`") != path else f"`{path}`"

    return re.sub(r"(!?)\[([^\]]*)\]\((\.\./[^)\s]*)\)", rewrite, markdown)


def _outside_images(page: Path) -> Iterator[str]:
    for target in re.findall(r"!\[[^\]]*\]\((\.\./[^)\s]*)\)", page.read_text("utf-8")):
        path = (page.parent / target).resolve()
        if path.is_relative_to(ROOT) and not path.is_relative_to(ROOT / "docs"):
            yield path.relative_to(ROOT).as_posix()


# --- HTTP -------------------------------------------------------------------------------------------------------------


def http_reference() -> str:
    """Every route and document of the OpenAPI document that a service answers with."""
    from service.api.handler import Handler
    from service.api.rest import create_http
    from service.settings import Settings

    document = create_http(Handler(), Settings()).openapi()
    lines = [
        "# HTTP API: every route and field\n",
        f"Written from the OpenAPI document, version {document['info']['version']}, which a running service gives at "
        "`/openapi.json` and draws at `/docs`. How to use it: [HTTP](../http.md). What is refused (4XX) or fails (5XX) "
        "is answered with a [ProblemReply](#problemreply) by every route; its codes: "
        "[Troubleshooting](../troubleshooting.md).\n",
    ]
    by_tag: dict[str, list[str]] = {}
    for path, methods in document["paths"].items():
        for method, route in methods.items():
            by_tag.setdefault(route.get("tags", ["other"])[0], []).append(_route(method.upper(), path, route))
    for tag, routes in by_tag.items():
        lines += [f"## {tag}\n", *routes]
    lines.append("## Documents\n")
    for name, schema in sorted(document["components"]["schemas"].items()):
        lines.append(_schema(name, schema))
    return "\n".join(lines)


def _route(method: str, path: str, route: Mapping[str, Any]) -> str:
    text = [f"### {method} `{path}`\n", f"{route.get('summary', '')}.\n"]
    if described := route.get("description"):
        text.append(described + "\n")
    rows = [
        (f"`{each['name']}`", each["in"], _type(each.get("schema", {})), each.get("description", ""))
        for each in route.get("parameters", ())
    ]
    if rows:
        text.append(_table(("parameter", "in", "type", ""), rows))
    rows = [
        (f"`{media}`", _type(content.get("schema", {})))
        for media, content in route.get("requestBody", {}).get("content", {}).items()
    ]
    if rows:
        text.append(_table(("body", "type"), rows))
    rows = [
        (
            status,
            reply.get("description", ""),
            ", ".join(_type(content["schema"]) for content in reply.get("content", {}).values()),
        )
        for status, reply in route.get("responses", {}).items()
        if status not in ("4XX", "5XX")
    ]
    text.append(_table(("status", "", "type"), rows))
    return "\n".join(text)


def _schema(name: str, schema: Mapping[str, Any]) -> str:
    text = [f"### {name}\n"]
    if described := schema.get("description"):
        text.append(described + "\n")
    required = set(schema.get("required", ()))
    rows = [
        (f"`{field}`", _type(value), "yes" if field in required else "", value.get("description", ""))
        for field, value in schema.get("properties", {}).items()
    ]
    if rows:
        text.append(_table(("field", "type", "required", ""), rows))
    return "\n".join(text)


def _type(schema: Mapping[str, Any]) -> str:
    if "$ref" in schema:
        name = schema["$ref"].rsplit("/", 1)[-1]
        return f"[{name}](#{name.lower()})"
    if "anyOf" in schema:
        return " or ".join(_type(part) for part in schema["anyOf"])
    if "enum" in schema:
        return " or ".join(f"`{value}`" for value in schema["enum"])
    if "const" in schema:
        return f"`{schema['const']}`"
    if "prefixItems" in schema:
        return f"({', '.join(_type(part) for part in schema['prefixItems'])})"
    if schema.get("type") == "array":
        return f"list of {_type(schema.get('items', {}))}"
    limits = [f"{sign} {schema[key]:g}" for key, sign in _LIMITS.items() if key in schema]
    kind = schema.get("format", schema.get("type", "any"))
    return f"{kind} ({', '.join(limits)})" if limits else str(kind)


_LIMITS = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}

# --- gRPC -------------------------------------------------------------------------------------------------------------


def grpc_reference(proto: str) -> str:
    """Every call and message of a .proto file, with its comments."""
    lines = [
        "# gRPC API: every call and field\n",
        "Written from `proto/physnet/v1/deformation.proto`. How to use it: [gRPC](../grpc.md).\n",
    ]
    messages = set(re.findall(r"^(?:message|enum) (\w+)", proto, re.MULTILINE))
    comment: list[str] = []
    rows: list[tuple[str, str, str]] = []
    for line in (raw.strip() for raw in proto.splitlines()):
        if line.startswith("//"):
            comment.append(line.removeprefix("//").strip())
            continue
        told, found = " ".join(comment), None
        if found := re.match(r"(service|message|enum) (\w+) \{(\})?", line):
            lines += [f"## {found[2]}\n", f"*{found[1]}.* {told}\n"]
            rows = []
        elif found := re.match(r"rpc (\w+)\((stream )?(\w+)\) returns \((stream )?(\w+)\)", line):
            asked, answered = ((found[i] or "") + f"[{found[i + 1]}](#{found[i + 1].lower()})" for i in (2, 4))
            lines += [f"### {found[1]}\n", f"{asked} → {answered}\n", f"{told}\n"]
        elif found := re.match(r"(?:(optional|repeated) )?([\w.]+|map<.+>) (\w+) = (\d+);", line):
            label = f"{found[1]} " if found[1] else ""
            kind = f"[{found[2]}](#{found[2].lower()})" if found[2] in messages else found[2]
            rows.append((f"`{found[3]}`", f"{label}{kind}", told))
        elif found := re.match(r"([A-Z]\w+) = (\d+);", line):
            rows.append((f"`{found[1]}`", found[2], told))
        elif line == "}" and rows:
            lines.append(_table(("field", "type", ""), rows))
            rows = []
        comment = []
    return "\n".join(lines)


# --- the command line -------------------------------------------------------------------------------------------------


def command_reference() -> str:
    """Every command with its help, as `physnet COMMAND --help` prints it."""
    from service.__main__ import parser
    from service.commands import exits

    whole = parser()
    lines = [
        "# Command line\n",
        "Written from the commands' own help. Shell completion: `physnet completion bash`. Colours switch off with "
        "`--no-color`, `NO_COLOR=1`, or by a pipe; `--json` prints one document for programs.\n",
        "## Exit codes\n",
        str(exits.__doc__).partition("\n\n")[2],
    ]
    (commands,) = (action for action in whole._actions if isinstance(action, argparse._SubParsersAction))
    for name, command in commands.choices.items():
        command.formatter_class = partial(command.formatter_class, width=80)
        command.epilog = None
        lines += [f"## physnet {name}\n", f"```text\n{command.format_help().rstrip()}\n```\n"]
    return "\n".join(lines)


# --- tables -----------------------------------------------------------------------------------------------------------


def materials_table() -> str:
    """Every named material, kind after kind."""
    from itertools import groupby

    from service.commands.terminal import pascals
    from service.core.materials import MATERIALS

    lines = []
    for category, entries in groupby(MATERIALS.values(), lambda entry: entry.category):
        rows = []
        for entry in entries:
            low_pa, high_pa = (pascals(bound) for bound in entry.young_modulus_range_pa)
            mark = "" if entry.checked else "~"
            rows.append(
                (f"`{entry.name}`", mark + pascals(entry.material.young_modulus_pa), f"{low_pa} to {high_pa}",
                 f"{entry.material.poisson_ratio:g}", entry.description, entry.source)
            )  # fmt: skip
        table = _table(("name", "E", "range", "ν", "", "source"), rows)
        lines += [f"### {category.capitalize()}\n", f'<div class="materials" markdown>\n\n{table}\n\n</div>\n']
    return "\n".join(lines)


def model_cards(models: Path) -> str:
    """The cards of the newest version of each model."""
    lines = [
        "# Model cards\n",
        "What the shipped models are, what they were trained on, and what they scored on bodies never trained on. Each "
        "lies beside its model (`models/<name>/<version>/CARD.md`), written by the export itself. When not to trust "
        "them: [Limits](limits.md).\n",
    ]
    for name in sorted(path.parent.parent for path in models.glob("*/*/CARD.md")):
        newest = max(name.glob("*/CARD.md"), key=lambda card: [int(part) for part in card.parent.name.split(".")])
        # One level down: the page has a title of its own.
        text = re.sub(r"^(#+ )", r"#\1", newest.read_text("utf-8"), flags=re.MULTILINE)
        if text not in lines:
            lines.append(text)
    return "\n".join(lines)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    def row(cells: Sequence[str]) -> str:
        return "| " + " | ".join(str(cell).replace("|", "\\|").replace("\n", " ") for cell in cells) + " |"

    return "\n".join([row(head), "|" + "---|" * len(head), *map(row, rows)]) + "\n"
