"""What a wrapper does, said in one line before it acts."""

from lerobot_gloves.checkpoints.training_data import trained_on
from lerobot_gloves.perturbations import written_out
from lerobot_gloves.specification import specification

from .configuration_gloves import GlovesConfig, library_perturbation
from .correction import Corrector


def start_line(config: GlovesConfig, corrector: Corrector) -> str:
    """Agent, adapter and its data, method, gate and what it was calibrated on."""
    told = [f"gloves: agent {_named(config.agent, config.agent_revision)}"]
    if config.perturbation is not None:
        told.append(f"perturbed by {written_out(library_perturbation(config.perturbation))}")
    data = trained_on(str(config.adapter), config.adapter_revision) or "unknown data"
    kind = corrector.adapter.config.type
    told.append(f"adapter {_named(config.adapter, config.adapter_revision)} ({kind}, trained on {data})")
    settings = corrector.settings
    by = " (recommended by gloves tune)" if settings.recommended else ""
    told.append(f"method {specification(corrector.editor, corrector.adapter.editors)}{by}")
    if settings.gate:
        told.append(f"gate at alpha {settings.alpha:g} of {settings.alpha_of} by {' + '.join(corrector.gate.names)}")
    else:
        told.append("no gate" if corrector.editor is None else "no gate: every chunk is edited")
    calibration = corrector.calibration
    if calibration is None:
        told.append("not calibrated")
    else:
        chunks = next(iter(calibration.scores.values())).shape[1]
        episodes = len(set(calibration.episode_of)) or len(calibration.episodes)
        told.append(f"calibrated on {calibration.repo_id}: {chunks} chunks of {episodes} episodes")
    return ", ".join(told)


def _named(checkpoint: str | None, revision: str | None) -> str:
    return f"{checkpoint}@{revision}" if revision else str(checkpoint)
