"""`gloves push`: a trained checkpoint's folder onto the Hub, with its calibration and a card of its own."""

from dataclasses import dataclass
from pathlib import Path

from lerobot.configs import PreTrainedConfig, parser

from lerobot_gloves.checkpoints import publishing
from lerobot_gloves.checkpoints.on_data import named_adapter
from lerobot_gloves.commands.errors import one_line_errors
from lerobot_gloves.commands.start import start


@dataclass
class PushConfig:
    """Push a checkpoint's folder: weights, processors, calibration, and a card that names its new place.

    gloves push --policy.path=FOLDER --policy.repo_id=USER/NAME

    Add --policy.private=true for a repository that only you see.
    """

    # What to push: --policy.path= a checkpoint's folder, --policy.repo_id= where to.
    policy: PreTrainedConfig | None = None

    def __post_init__(self) -> None:
        self.policy = named_adapter()
        if not Path(str(self.policy.pretrained_path)).is_dir():
            raise ValueError(f"{self.policy.pretrained_path} is no folder, so there is nothing to push")
        user, _, name = (self.policy.repo_id or "").partition("/")
        if not user or not name or "/" in name:
            raise ValueError(f"policy.repo_id must look like user/name, not {self.policy.repo_id!r}")

    @classmethod
    def __get_path_fields__(cls) -> list[str]:
        return ["policy"]


@parser.wrap()
def push(cfg: PushConfig) -> str:
    """Run `gloves push`; the repository's address."""
    assert cfg.policy is not None and cfg.policy.repo_id is not None
    folder = Path(str(cfg.policy.pretrained_path))
    url = publishing.push(folder, cfg.policy.repo_id, private=cfg.policy.private)
    print(f"pushed to {url}")
    return url


def main() -> None:
    """Entry point."""
    start()
    with one_line_errors("gloves push"):
        push()
