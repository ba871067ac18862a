"""Writes `src/posed/_schema.py` and `src/posed/_requests.py` from the JSON Schema of the websocket.

    python clients/python/generate.py            # writes both
    python clients/python/generate.py --check    # ends with 1 where one of them is not what it would write

Types of messages become `TypedDict`s of the same names; requests become methods, once awaited and once blocking.
"""

import argparse
import json
import keyword
import pathlib
import sys
import textwrap
from typing import Any

HERE = pathlib.Path(__file__).resolve().parent
SCHEMA = HERE.parents[1] / "docs/schema/posed.v1.schema.json"
FOLDER = HERE / "src/posed"
NOTE = "Generated from docs/schema/posed.v1.schema.json by clients/python/generate.py; do not edit."
SIMPLE = {"string": "str", "integer": "int", "number": "float", "boolean": "bool", "null": "None", "object": "dict[str, Any]"}
# What a client receives by subscription is asked for by iterating, not by these requests.
FEED = ("subscribe", "unsubscribe", "resume")

Schema = dict[str, Any]


def camel(text: str) -> str:
    return "".join(part[:1].upper() + part[1:] for part in text.replace(".", "_").split("_"))


def docstring(text: str, indent: int) -> list[str]:
    """A docstring; our own links to Rust items become plain code."""
    text = text.replace("[`", "`").replace("`]", "`").replace("\\", "\\\\")
    wrapped = textwrap.wrap(" ".join(text.split()), 116 - indent)
    space = " " * indent
    if len(wrapped) == 1:
        return [f'{space}"""{wrapped[0]}"""']
    return [f'{space}"""{wrapped[0]}', *(space + line for line in wrapped[1:]), f'{space}"""']


class Types:
    """Python types out of the schema's definitions."""

    def __init__(self, definitions: dict[str, Schema]) -> None:
        self.definitions = definitions
        self.lines: list[str] = []
        # The messages of a client's feed have their `type` beside what the referenced definition has.
        self.kinds = {
            variant["$ref"].rsplit("/", 1)[1]: variant["properties"]["type"]["const"]
            for variant in definitions["ServerMessage"]["oneOf"]
        }

    def type_of(self, schema: Schema | bool) -> str:
        """How a value is annotated."""
        if schema is True or not isinstance(schema, dict):
            return "Any"
        if "$ref" in schema:
            return str(schema["$ref"].rsplit("/", 1)[1])
        if "const" in schema:
            return f"Literal[{json.dumps(schema['const'])}]"
        if "enum" in schema:
            return f"Literal[{', '.join(json.dumps(value) for value in schema['enum'])}]"
        for key in ("anyOf", "oneOf"):
            if key in schema:
                return self.union([self.type_of(one) for one in schema[key]])
        kind = schema.get("type")
        if isinstance(kind, list):
            return self.union([self.type_of({**schema, "type": one}) for one in kind])
        if kind == "array":
            return f"list[{self.type_of(schema.get('items', True))}]"
        if kind == "object" and isinstance(schema.get("additionalProperties"), (dict, bool)) and "properties" not in schema:
            return f"dict[str, {self.type_of(schema['additionalProperties'])}]"
        return SIMPLE[kind] if kind else "Any"

    def union(self, types: list[str]) -> str:
        """One of them; several literals are one."""
        literals = [one.removeprefix("Literal[").removesuffix("]") for one in types if one.startswith("Literal[")]
        others = [one for one in types if not one.startswith("Literal[")]
        return " | ".join(dict.fromkeys([*([f"Literal[{', '.join(literals)}]"] if literals else []), *others]))

    def resolved(self, schema: Schema) -> Schema:
        """An object with what it refers to."""
        if "$ref" not in schema:
            return schema
        whole = self.resolved(self.definitions[schema["$ref"].rsplit("/", 1)[1]])
        return {
            **whole,
            "properties": {**whole.get("properties", {}), **schema.get("properties", {})},
            "required": [*whole.get("required", []), *schema.get("required", [])],
            "description": schema.get("description", whole.get("description", "")),
        }

    def define(self, name: str, schema: Schema) -> None:
        extra: dict[str, Schema] = {"type": {"const": self.kinds[name], "description": "Which message it is."}} if name in self.kinds else {}
        given = schema.get("oneOf", []) or schema.get("anyOf", [])
        variants = [self.resolved(one) for one in given]
        # Where each has a name of its own already, theirs are enough.
        named = name == "ServerMessage" or "anyOf" in schema and all("$ref" in one for one in given)
        if variants and all("properties" in one for one in variants) and not named:
            names = []
            for variant in variants:
                consts = [str(one["const"]) for one in variant["properties"].values() if "const" in one]
                kind = consts[0] if consts else "_".join(sorted(variant["properties"]))
                names.append(name + camel(kind))
                self.object(names[-1], {
                    "description": variant.get("description") or schema.get("description", ""),
                    "properties": {**extra, **schema.get("properties", {}), **variant["properties"]},
                    "required": [*extra, *schema.get("required", []), *variant.get("required", [])],
                })
            self.alias(name, " | ".join(names), schema)
        elif "properties" in schema:
            self.object(name, {**schema, "properties": {**extra, **schema["properties"]}, "required": [*extra, *schema.get("required", [])]})
        else:
            self.alias(name, self.type_of(schema), schema)

    def object(self, name: str, schema: Schema) -> None:
        required = set(schema.get("required", []))
        entries = sorted(schema["properties"].items())
        annotated = {
            key: self.type_of(one) if key in required else f"NotRequired[{self.type_of(one)}]" for key, one in entries
        }
        said = docstring(schema.get("description", name), 4)
        if all(key.isidentifier() and not keyword.iskeyword(key) for key in annotated):
            self.lines += ["", "", f"class {name}(TypedDict):", *said]
            for key, one in entries:
                self.lines += ["", f"    {key}: {annotated[key]}"]
                if isinstance(one, dict) and "description" in one:
                    self.lines += docstring(one["description"], 4)
        else:
            # Keys that Python keeps for itself, or that have a dot.
            self.lines += ["", "", f"{name} = TypedDict(", f'    "{name}",', "    {"]
            self.lines += [f'        "{key}": "{annotated[key]}",' if '"' not in annotated[key] else f"        \"{key}\": '{annotated[key]}'," for key in annotated]
            self.lines += ["    },", ")", *docstring(schema.get("description", name), 0)]

    def alias(self, name: str, target: str, schema: Schema) -> None:
        quoted = f"'{target}'" if '"' in target else f'"{target}"'
        self.lines += ["", "", f"{name}: TypeAlias = {quoted}", *docstring(schema.get("description", name), 0)]


def schema_module(whole: Schema) -> str:
    definitions = whole["$defs"]
    types = Types(definitions)
    for name in sorted(definitions):
        types.define(name, definitions[name])
    events = [
        kind for name, kind in types.kinds.items() if "event_id" in types.resolved(definitions[name]).get("properties", {})
    ]
    fields = [one["const"] for one in definitions["Field"]["oneOf"]]
    head = [
        f'"""Types of all messages. {NOTE}"""', "", "from __future__ import annotations", "",
        "from typing import Any, Literal, NotRequired, TypeAlias, TypedDict", "",
        f"EVENT_TOPICS: tuple[str, ...] = {tuple(sorted(events))!r}".replace("'", '"'),
        '"""Topics whose messages are events: never dropped, and asked for again after a reconnection."""', "",
        f"FIELDS: tuple[str, ...] = {tuple(fields)!r}".replace("'", '"'),
        '"""What a `sensors` message can say of each sensor."""',
    ]
    return "\n".join([*head, *types.lines]) + "\n"


def requests_module(whole: Schema) -> str:
    definitions = whole["$defs"]
    types = Types(definitions)
    answers = definitions["Answers"]["properties"]
    used: set[str] = set()
    calls = [call for call in definitions["Call"]["oneOf"] if call["properties"]["type"]["const"] not in FEED]

    def method(call: Schema, awaited: bool) -> list[str]:
        properties = {key: one for key, one in call["properties"].items() if key not in ("type", "id")}
        name = call["properties"]["type"]["const"]
        needed = [key for key in call["required"] if key in properties]
        others = sorted(key for key in properties if key not in needed)
        safe = {key: key + "_" if keyword.iskeyword(key) else key for key in properties}
        annotated = {key: types.type_of(one) for key, one in properties.items()}
        parameters = ["self", *(f"{safe[key]}: {annotated[key]}" for key in needed)]
        if others:
            parameters.append("*")
            parameters += [f"{safe[key]}: {types.union([*annotated[key].split(' | '), 'None'])} = None" for key in others]
        answer = types.type_of(answers[name]) if name in answers else "None"
        for note in [*annotated.values(), answer]:
            used.update(word for word in note.replace("[", " ").replace("]", " ").replace(",", " ").split() if word in definitions)
        said = call["description"]
        about = [f"`{safe[key]}`: {properties[key]['description']}" for key in [*needed, *others] if "description" in properties[key]]
        doc = docstring(said, 8)
        if about:
            doc = [f'        """{said}', ""]
            for line in about:
                doc += [8 * " " + part for part in textwrap.wrap(" ".join(line.replace("[`", "`").replace("`]", "`").split()), 108, subsequent_indent="    ")]
            doc.append('        """')
        keys = ["type", *needed, *others]
        sent = ", ".join(f'"{key}": {json.dumps(name) if key == "type" else safe[key]}' for key in keys)
        asked = f"{'await ' if awaited else ''}self.request({{{sent}}})"
        lines = ["", f"    {'async ' if awaited else ''}def {name.replace('.', '_')}({', '.join(parameters)}) -> {answer}:", *doc]
        return lines + ([f"        {asked}"] if answer == "None" else [f"        return cast({answer}, {asked})"])

    bodies = {awaited: [line for call in calls for line in method(call, awaited)] for awaited in (True, False)}
    literal = "Literal, " if any("Literal[" in line for line in bodies[True]) else ""
    lines = [
        f'"""Requests as methods. {NOTE}"""', "", "from __future__ import annotations", "", f"from typing import Any, {literal}cast", "", "from ._schema import (",
        *(f"    {name}," for name in sorted(used)), ")", "", "",
        "class AwaitedRequests:", '    """Requests, awaited; a refused one raises `Refused`."""', "",
        "    async def request(self, request: dict[str, Any]) -> Any:",
        '        """Sends a request by its `type`; what is None is left out. The `result` of the answer."""',
        "        raise NotImplementedError", *bodies[True], "", "",
        "class BlockingRequests:", '    """Requests that wait for their answer; a refused one raises `Refused`."""', "",
        "    def request(self, request: dict[str, Any]) -> Any:",
        '        """Sends a request by its `type`; what is None is left out. The `result` of the answer."""',
        "        raise NotImplementedError", *bodies[False],
    ]
    return "\n".join(lines) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description="Writes the types and requests of the Python client from the schema.")
    parser.add_argument("--check", action="store_true", help="write nothing; end with 1 where a file is not up to date")
    check = parser.parse_args().check
    whole = json.loads(SCHEMA.read_text(encoding="utf-8"))
    stale = []
    for name, text in (("_schema.py", schema_module(whole)), ("_requests.py", requests_module(whole))):
        path = FOLDER / name
        if path.exists() and path.read_text(encoding="utf-8") == text:
            continue
        stale.append(name)
        if not check:
            path.write_text(text, encoding="utf-8")
    if check and stale:
        print(f"{', '.join(stale)}: not what the schema says; run clients/python/generate.py", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
