"""The file of a benchmark, as the command's arguments: checked key by key, with what was chosen and overridden."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

import yaml
from lerobot.configs.parser import PLUGIN_DISCOVERY_SUFFIX, load_plugin, parse_arg, parse_plugin_args
from lerobot.envs import EnvConfig

from lerobot_gloves.benchmark.matrix import Method, Setting, Task
from lerobot_gloves.system.errors import one_line
from lerobot_gloves.system.values import NOTHING, text_value

OVERRIDE = "--tasks."
CHECKPOINTS = ("agent", "adapter")
"""Keys whose values are folders or Hub ids, whatever they look like."""


def complete(arguments: Sequence[str], config_class: type) -> list[str]:
    """The arguments with the tasks of the file that `--config_path` names, as LeRobot's parser takes them.

    The parser takes options of a fixed name only, so what goes into the tasks, by their names, is put there here:
    the settings of the file that `chosen` names, then options such as `--tasks.slalom.methods.FEEG.alpha=0.1`.

    Args:
        arguments: The command's.
        config_class: The dataclass that they are for.

    Raises:
        ValueError: If the file is not YAML, or has a key or label that is not valid; the message lists what is.
        FileNotFoundError: If there is no such file.
    """
    overrides = [argument for argument in arguments if argument.startswith(OVERRIDE)]
    others = [argument for argument in arguments if not argument.startswith(OVERRIDE)]
    path = parse_arg("config_path", others)
    if path is None:
        if overrides:
            raise ValueError(f"{overrides[0]} overrides a task of a file: name the file by --config_path")
        return others
    for package in parse_plugin_args(PLUGIN_DISCOVERY_SUFFIX, others).values():
        load_plugin(package)  # as the parser will: its environments are choices too
    content = read_yaml(Path(path))
    check_keys(content, config_class, path, complete=False)
    tasks = content.get("tasks")
    if not tasks:
        return [*others, *overrides]
    check_tasks(tasks, path, complete=False)
    chosen = parse_arg("chosen", others) or content.get("chosen")
    if chosen:
        tasks = merged(tasks, read_chosen(str(chosen)), str(chosen))
    for override in overrides:
        tasks = merged(tasks, nested(override), override)
    check_tasks(tasks, path)
    return [*others, f"--tasks={json.dumps(tasks)}"]


def read_yaml(path: Path) -> dict[str, Any]:
    """A YAML file that holds names and values.

    Raises:
        ValueError: If it does not, or has a name twice.
        FileNotFoundError: If there is no such file.
    """
    path = path.expanduser()
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {path}")
    try:
        content = yaml.load(path.read_text(), UniqueKeys)
    except DuplicateKeyError as error:
        raise ValueError(f"{path}, {error}") from error
    except yaml.YAMLError as error:
        raise ValueError(f"{path} is not YAML: {one_line(error)}") from error
    if not isinstance(content, dict):
        raise ValueError(f"{path} does not hold names and values")
    return content


class DuplicateKeyError(yaml.YAMLError):
    """A name stands twice in one place of a YAML file."""


class UniqueKeys(yaml.SafeLoader):
    """YAML, but of two values of one name the last does not win silently."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen = set()
        for key, _ in node.value:
            # `<<`, which puts other mappings below, is resolved later; YAML allows several.
            if key.tag != "tag:yaml.org,2002:merge" and isinstance(key, yaml.ScalarNode):
                if key.value in seen:
                    raise DuplicateKeyError(f"line {key.start_mark.line + 1}: the key {key.value!r} is there twice")
                seen.add(key.value)
        return super().construct_mapping(node, deep)


def read_chosen(path: str) -> dict[str, Any]:
    """The tasks of a file that a search wrote, which has nothing else.

    Raises:
        ValueError: If the file is not YAML, or has other keys.
        FileNotFoundError: If there is no such file.
    """
    content = read_yaml(Path(path))
    for key in content:
        if key != "tasks":
            raise ValueError(f"{path} has no key {key!r}: a file of chosen settings holds tasks only")
    return content.get("tasks") or {}


def nested(override: str) -> dict[str, Any]:
    """The tasks that `--tasks.A.B=VALUE` speaks of: `{A: {B: VALUE}}`.

    Raises:
        ValueError: If it has no value, or one that is not YAML.
    """
    name, equals, text = override.partition("=")
    if not equals:
        raise ValueError(f"{override} has no value: write {override}=VALUE")
    keys = name.removeprefix(OVERRIDE).split(".")
    try:
        is_text = keys[-1] in CHECKPOINTS and text not in NOTHING
        value: Any = text_value(text) if is_text else yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ValueError(f"{override}: the value is not YAML: {one_line(error)}") from error
    for key in reversed(keys):
        value = {key: value}
    return value


def merged(tasks: dict[str, Any], over: Mapping[str, Any], source: str) -> dict[str, Any]:
    """Tasks with what goes over them.

    Args:
        tasks: What is below.
        over: What goes over it.
        source: Where that comes from, for the error.

    Raises:
        ValueError: If `over` has keys that do not exist, or speaks of a task or a method that there is not.
    """
    check_tasks(over, source, complete=False)

    def merge(below: Any, above: Any) -> Any:
        if not isinstance(below, dict) or not isinstance(above, Mapping):
            return above
        return {**below, **{key: merge(below.get(key), value) for key, value in above.items()}}

    for name, task in over.items():
        if name not in tasks:
            raise ValueError(f"{source}: there is no task {name!r}: choose from {', '.join(tasks)}")
        known = tasks[name].get("methods") or {}
        for label in task.get("methods") or ():
            if label not in known:
                raise ValueError(f"{source}: {name} has no method {label!r}: choose from {', '.join(known)}")
    return merge(tasks, over)


def check_tasks(tasks: Any, path: str, *, complete: bool = True) -> None:
    """Refuse tasks with keys or values that make no sense, or, if they shall be complete, without keys that must be.

    Raises:
        ValueError: If there are any; the message lists what is valid.
    """
    if not isinstance(tasks, dict):
        raise ValueError(f"{path}: tasks is {tasks!r}, but must be tasks by name")
    for name, task in tasks.items():
        place = f"{path}: tasks.{name}"
        check_keys(task, Task, place, complete=complete)
        if complete:
            env = task["env"]
            kind = env.get("type") if isinstance(env, dict) else env
            if kind not in (known := sorted(EnvConfig.get_known_choices())):
                raise ValueError(f"{place}.env: unknown type {kind!r}: choose from {', '.join(known)}")
        for kind in ("perturbations", "methods"):
            if kind in task and (not isinstance(task[kind], dict) or not task[kind]):
                raise ValueError(f"{place}.{kind} is {task[kind]!r}, but must be at least one by label")
        for label, perturbation in task.get("perturbations", {}).items():
            if not isinstance(perturbation, str):
                raise ValueError(
                    f"{place}.perturbations.{label} is {perturbation!r}, but must be none or a specification such as "
                    "noised:sigma=0.005"
                )
        for label, method in task.get("methods", {}).items():
            check_method(method, f"{place}.methods.{label}")


def check_method(method: Any, place: str) -> None:
    """Refuse a method, or what goes over one, with keys or values that make no sense.

    Raises:
        ValueError: If there are any; the message lists what is valid.
    """
    check_keys(method, Method, place, complete=False)
    if "editor" in method and not isinstance(method["editor"], str):
        raise ValueError(
            f"{place}.editor is {method['editor']!r}, but must be none or an editor such as feeg:start=0.5"
        )
    settings = method.get("settings") or []
    if not isinstance(settings, list):
        raise ValueError(f"{place}.settings is {settings!r}, but must be a list")
    for setting in settings:
        check_keys(setting, Setting, f"{place}.settings")


def check_keys(values: Any, target: type, place: str, *, complete: bool = True) -> None:
    """Refuse values that the dataclass `target` cannot be made of; not `complete`: together with others.

    Raises:
        ValueError: If a key is not one of its fields, or one of those without a default is missing.
    """
    known = {one.name: one.default is MISSING and one.default_factory is MISSING for one in fields(target)}
    if not isinstance(values, dict):
        raise ValueError(f"{place} is {values!r}, but must have some of the keys {', '.join(known)}")
    for key in values:
        if key not in known:
            raise ValueError(f"{place} has no key {key!r}: choose from {', '.join(known)}")
    for key, required in known.items():
        if complete and required and key not in values:
            raise ValueError(f"{place} lacks the key {key!r}")
