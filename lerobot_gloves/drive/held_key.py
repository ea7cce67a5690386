"""A dead man's key: whether it is held at this moment."""

from types import TracebackType
from typing import Any

from lerobot.utils.keyboard_input import pynput_can_capture


class HeldKey:
    """Listens to the whole keyboard by pynput, whatever window is in front, while it is entered as a context.

    Args:
        name: A letter or a digit, or what pynput calls another key, such as `space` or `shift`.

    Raises:
        ValueError: If there is no such key.
        OSError: If the keyboard cannot be listened to: a terminal tells of keys that go down, never of ones let go.
    """

    def __init__(self, name: str) -> None:
        if not pynput_can_capture():
            raise OSError(
                "the dead man's key needs a keyboard of which a program is told what is let go (a desktop under X11, "
                "macOS or Windows), and there is none: --limits.key=null goes without it"
            )
        from pynput import keyboard

        if len(name) == 1:
            self._key: Any = keyboard.KeyCode.from_char(name)
        elif hasattr(keyboard.Key, name):
            self._key = getattr(keyboard.Key, name)
        else:
            named = ", ".join(key.name for key in keyboard.Key)
            raise ValueError(f"limits.key is {name!r}, but must be a letter, a digit, or one of {named}")
        self._held = False
        self._listener = keyboard.Listener(on_press=self._press, on_release=self._release)

    def __call__(self) -> bool:
        """Whether it is held; never once nobody listens any more."""
        return self._held and self._listener.running

    def __enter__(self) -> "HeldKey":
        self._listener.start()
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._listener.stop()

    def _press(self, key: Any) -> None:
        self._held = self._held or key == self._key

    def _release(self, key: Any) -> None:
        self._held = self._held and key != self._key
