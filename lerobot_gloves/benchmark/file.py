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

OVERRIDE = "--tasks."


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
    if not isinstance(tasks, dict):
        raise ValueError(f"{path}: tasks is {tasks!r}, but must be tasks by name")
    chosen = parse_arg("chosen", others) or content.get("chosen")
    if chosen:
        tasks = merged(tasks, read_yaml(Path(chosen)).get("tasks") or {}, chosen)
    for override in overrides:
        tasks = merged(tasks, nested(override), override)
    check_tasks(tasks, path)
    return [*others, f"--tasks={json.dumps(tasks)}"]


def read_yaml(path: Path) -> dict[str, Any]:
    """A YAML file that holds names and values.

    Raises:
        ValueError: If it does not.
        FileNotFoundError: If there is no such file.
    """
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {path}")
    try:
        content = yaml.safe_load(path.read_text())
    except yaml.YAMLError as error:
        raise ValueError(f"{path} is not YAML: {' '.join(str(error).split())}") from error
    if not isinstance(content, dict):
        raise ValueError(f"{path} does not hold names and values")
    return content


def nested(override: str) -> dict[str, Any]:
    """The tasks that `--tasks.A.B=VALUE` speaks of: `{A: {B: VALUE}}`.

    Raises:
        ValueError: If it has no value.
    """
    name, equals, text = override.partition("=")
    if not equals:
        raise ValueError(f"{override} has no value: write {override}=VALUE")
    value = yaml.safe_load(text)
    for key in reversed(name.removeprefix(OVERRIDE).split(".")):
        value = {key: value}
    return value


def merged(tasks: dict[str, Any], over: Mapping[str, Any], source: str) -> dict[str, Any]:
    """Tasks with what goes over them.

    Raises:
        ValueError: If that speaks of a task or a method that there is not.
    """

    def merge(below: Any, above: Any) -> Any:
        if not isinstance(below, dict) or not isinstance(above, Mapping):
            return above
        return {**below, **{key: merge(below.get(key), value) for key, value in above.items()}}

    for name, task in over.items():
        if name not in tasks:
            raise ValueError(f"{source}: there is no task {name!r}: choose from {', '.join(tasks)}")
        known = (tasks[name] or {}).get("methods") or {}
        for label in (task.get("methods") if isinstance(task, Mapping) else None) or ():
            if label not in known:
                raise ValueError(f"{source}: {name} has no method {label!r}: choose from {', '.join(known)}")
    return merge(tasks, over)


def check_tasks(tasks: Mapping[str, Any], path: str) -> None:
    """Refuse tasks with keys that do not exist, or without those that must.

    Raises:
        ValueError: If there are any; the message lists what is valid.
    """
    for name, task in tasks.items():
        place = f"{path}: tasks.{name}"
        check_keys(task, Task, place)
        env = task["env"]
        kind = env.get("type") if isinstance(env, dict) else env
        if kind not in EnvConfig.get_known_choices():
            choices = ", ".join(sorted(EnvConfig.get_known_choices()))
            raise ValueError(f"{place}.env: unknown type {kind!r}: choose from {choices}")
        for kind in ("perturbations", "methods"):
            if not isinstance(task[kind], dict) or not task[kind]:
                raise ValueError(f"{place}.{kind} is {task[kind]!r}, but must be at least one by label")
        for label, method in task["methods"].items():
            check_keys(method, Method, f"{place}.methods.{label}")
            for setting in method.get("settings") or ():
                check_keys(setting, Setting, f"{place}.methods.{label}.settings")


def check_keys(values: Any, target: type, place: str, *, complete: bool = True) -> None:
    """Refuse values that the dataclass `target` cannot be made of; not `complete`: with others besides.

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
