"""Links to the API reference, for names in single backticks and for types in signatures.

A name in single backticks is code. It becomes a link if the API reference contains the name:

- In a docstring, the name is looked up as in the code: as a member of the class, as a name of the module, and as a
  public name. `wait`, `Motion.wait` and `robot.motion.jog` are found in this way.
- In a page, the name must have a dot, a capital letter or parentheses, such as `Motion`, `urlink.connect` or
  `connect()`. A `robot` is a `urlink.Robot`, and on the pages of rhdlink a `rhdlink.Variables`.

All other names stay code without a link, and so do ambiguous names. The type of a property is known from its
annotation, so that `robot.realtime.plot` leads to `Feed.plot`.
"""

from __future__ import annotations

import re
from typing import Any

import signatures
from _names import Names
from docutils import nodes
from docutils.parsers.rst.states import Inliner
from sphinx.addnodes import desc, pending_xref
from sphinx.application import Sphinx
from sphinx.builders import Builder
from sphinx.environment import BuildEnvironment
from sphinx.transforms.post_transforms import SphinxPostTransform
from sphinx.util.nodes import make_refnode

#: A name with dots, which can be a call: `wait`, `robot.motion.jog()`, `urlink.connect("sim://")`.
_NAME = re.compile(r"([A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*)(\(.*\))?", re.DOTALL)

#: Pages about mobile robots, in which a robot is an object of rhdlink.
_OF_RHDLINK = re.compile(r"rhd|missions|smrcl|coming-from-mrc|api/rhdlink")
#: Pages whose names are those of a protocol.
_WITHOUT_LINKS = re.compile(r"protocols/|layouts|rtde-variables|parameters")


def name_role(
    role: str, raw: str, text: str, line: int, inliner: Inliner, options: Any = None, content: Any = ()
) -> tuple[list[nodes.Node], list[nodes.system_message]]:
    """Return the code of a name in a docstring, with the place in which its link is looked up."""
    env: BuildEnvironment = inliner.document.settings.env
    # A backslash that protects a character has become a zero byte.
    literal = nodes.literal(raw, text.replace("\x00", ""), classes=["name"])
    literal["scope"] = (env.ref_context.get("py:module"), env.ref_context.get("py:class"))
    return [literal], []


class LinkNames(SphinxPostTransform):
    """Make links of the names in single backticks that the API reference contains."""

    default_priority = 8

    def run(self, **kwargs: Any) -> None:
        """Look up each name outside of headings and links."""
        for literal in list(self.document.findall(nodes.literal)):
            name = self._meaning(literal)
            if name is not None and not _is_out_of_place(literal, name):
                link = _link(self.env, self.app.builder, self.env.docname, name, literal.deepcopy())
                if link is not None:
                    literal.parent.replace(literal, link)

    def _meaning(self, literal: nodes.literal) -> str | None:
        match = _NAME.fullmatch(literal.astext())
        if match is None:
            return None
        text, call = match.groups()
        page = self.env.docname
        names = _names(self.env)
        if "scope" in literal:
            return names.in_docstring(text, *literal["scope"])
        if _WITHOUT_LINKS.match(page) or not (call or "." in text or re.match(r"[A-Z]\w*[a-z]", text)):
            return None
        return names.public(text, _OF_RHDLINK.match(page) is not None)


def link_type(app: Sphinx, env: BuildEnvironment, node: pending_xref, content: nodes.Node) -> nodes.reference | None:
    """Return the link of a type in a signature, or of an error under `Raises`."""
    if node.get("refdomain") != "py":
        return None
    target = node["reftarget"]
    page = node.get("refdoc", env.docname)
    if target in signatures.NAMES:
        link = app.builder.get_relative_uri(page, "api") + f"#{signatures.ANCHOR}"
        return nodes.reference("", "", content, internal=True, refuri=link)
    name = _names(env).in_docstring(target, node.get("py:module"), node.get("py:class"))
    return None if name is None else _link(env, app.builder, page, name, content)


def _names(env: BuildEnvironment) -> Names:
    names = getattr(env, "_documented_names", None)
    if names is None:
        names = env._documented_names = Names(  # type: ignore[attr-defined]
            name for name, found in env.domains.python_domain.objects.items() if found.objtype != "module"
        )
    return names


def _link(env: BuildEnvironment, builder: Builder, page: str, name: str, content: nodes.Node) -> nodes.reference | None:
    found = env.domains.python_domain.objects[name]
    return make_refnode(builder, page, found.docname, found.node_id, content, name)


def _is_out_of_place(literal: nodes.literal, name: str) -> bool:
    """Whether a link would be in a heading, in another link, or in the description to which it leads."""
    parent = literal.parent
    while parent is not None:
        if isinstance(parent, (nodes.title, nodes.reference, pending_xref)):
            return True
        if isinstance(parent, desc):
            return name in parent[0]["ids"]
        parent = parent.parent
    return False


def forget(app: Sphinx, env: BuildEnvironment) -> None:
    """Look up all documented names again, because the pages were read again."""
    env._documented_names = None  # type: ignore[attr-defined]


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the role, the transform and the function for types."""
    app.add_role("name", name_role)
    app.add_post_transform(LinkNames)
    app.connect("env-updated", forget)
    app.connect("missing-reference", link_type)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
