"""The wrapper: it asks the agent, corrects what the agent proposes, and is a LeRobot policy itself."""

import copy
import logging
import weakref
from collections import deque
from typing import Any, cast

import torch
import torch.nn.functional as F
from lerobot.utils.constants import ACTION
from torch import Tensor

from lerobot_gloves.checkpoints.loading import load_policy
from lerobot_gloves.generators import Episodes, spawn
from lerobot_gloves.perturbations import Perturbation
from lerobot_gloves.system.display import Display
from lerobot_gloves.tasks.configuration import ClippedAction

from .activity import start_line
from .configuration_gloves import GlovesConfig
from .correction import Correction, Corrector
from .decoding import Decoder
from .finite import check_finite
from .journal import Journal
from .plan import Plan
from .proposals import ChunkTap, Proposal
from .realtime import LeftOver
from .saved import SavedWrapper
from .settings import Settings

logger = logging.getLogger(__name__)

NOTHING = Plan(torch.empty(0, 0, 0), executed=0, step=0)
"""The plan before an episode's first."""


class GlovesPolicy(SavedWrapper):
    """An agent whose proposals an adapter corrects.

    The agent is asked for an action at every step, so that its own queues and histories go on as without a wrapper. The
    chunk that it computes is its proposal; whenever an unedited action becomes due, the adapter takes the next ones, at
    most its own chunk size, and corrects them under the observation of that moment. It sees them as they are proposed,
    also those that the agent will not execute. Actions in and out are raw.

    Attributes:
        perturbation: What makes the agent imperfect, None for nothing. Its draws are the wrapper's, so it is a copy of
            the configuration's.
        correction: What the last `select_action` did to the proposals that became due, a `Correction`; None if none
            became due, or there is no adapter.
        running: Which environments' episodes still run, bool (B,), set before `select_action` by a caller who knows:
            then only their proposals are corrected. None: all are, until the next `reset`.
    """

    def __init__(self, config: GlovesConfig, **_: object):
        super().__init__(config)
        if not config.agent:
            raise ValueError(
                "gloves wraps an agent: name it by --policy.path=AGENT --policy.wrap=gloves, or by --policy.agent=AGENT"
            )
        if config.adapter is None:
            logger.warning("gloves: no adapter (--policy.adapter), so nothing corrects: %s acts alone", config.agent)
        # Neither agent nor adapter is a submodule: their weights are not the wrapper's to save.
        self._agent = load_policy(config.agent_config, config.device)
        self._tap = ChunkTap(self._agent.policy)
        self._decode = Decoder(self._agent.postprocess)
        # The adapter's weights are drawn before they are loaded, but the agent's noise shall be as without an adapter.
        with torch.random.fork_rng(devices=[]):
            self._corrector = Corrector(config, config.adapter) if config.adapter else None
        self._clipped = isinstance((config.output_features or {}).get(ACTION), ClippedAction)
        if self._corrector is not None and self._clipped:
            self._corrector.bounds = None
        self.perturbation = cast("Perturbation | None", copy.deepcopy(config.perturbation))  # every choice is one
        self._journal = Journal(config.log, config.control_period, config.log_actions)
        self._display = Display.asked(config)
        self._episodes = Episodes()
        if self._corrector is not None and logger.isEnabledFor(logging.INFO):  # who silences the one wants no other
            logger.info(start_line(config, self._corrector))
            weakref.finalize(self, self._journal.report)  # at the latest when the program ends
        self.reset()

    def bound_actions(self, low: Tensor, high: Tensor) -> None:
        """Keep edited actions inside an environment's action space, told by a caller who knows it.

        Unedited ones stay as they were proposed. Nobody needs to tell of an environment that clips actions itself.

        Args:
            low: The least value of each entry of a raw action, (A,).
            high: The largest.
        """
        if self._corrector is not None and not self._clipped:
            self._corrector.bounds = (low, high)

    def adjust(self, **options: Any) -> Settings | None:
        """Change method, gate, score or alpha from the next proposal on; agent, adapter and episode go on.

        Returns:
            What then holds, with what nobody named; None without an adapter.

        Raises:
            ValueError: As at loading, for options by the wrapper's names such as `gate=True`; then nothing has changed.
        """
        config: Any = self.config
        if self._corrector is not None:
            vars(tried := copy.copy(config)).update(options)
            self._corrector.settle(tried)
        vars(config).update(options)
        return None if self._corrector is None else self._corrector.settings

    def statistics(self) -> dict[str, float]:
        """Totals so far: chunks, intervention rate, distance, milliseconds and network evaluations a chunk."""
        return self._journal.summary()

    def reset(self) -> None:
        """A new episode begins in every environment."""
        self._agent.reset()
        if self._corrector is not None:
            self._corrector.reset()
        self._episodes.reset()
        self._journal.reset()
        self.correction: Correction | None = None
        self.running: Tensor | None = None
        self._step = 0
        self._plan = NOTHING
        self._returned: Tensor | None = None
        self._history: deque[Tensor] = deque(maxlen=0 if self._corrector is None else self._corrector.history)
        self._action_queue: deque[Tensor] = deque()

    @torch.no_grad()
    def select_action(self, batch: dict[str, Any], **kwargs: Any) -> Tensor:
        """The next raw action (B, A) for raw observations.

        Raises:
            NonFiniteProposalError: If the agent proposes, or the editor returns, NaN or infinity.
        """
        self._tap.clear()
        self.correction = None
        action = self._agent.policy.select_action(self._agent.preprocess(dict(batch)), **kwargs)
        self._begin(action.shape[0])
        proposal = self._tap.proposal(action)
        if proposal is not None:
            self._propose(proposal)
        elif self._plan.over and not self._action_queue:
            self._propose(Proposal(action[:, None], 1))
        self._see(batch, action.shape[0])
        if not self._action_queue:
            window, due = self._plan.take(self._covered)
            self._action_queue.extend(self._correct(batch, window)[:, :due].unbind(dim=1))
        action = self._action_queue.popleft()
        self._show(batch, self._plan.actions[:, self._step - self._plan.step], action)
        self._step += 1
        return action

    @property
    def executed(self) -> int:
        """How many actions of the agent's last proposal it executes, the first ones."""
        return self._plan.executed

    @property
    def unread(self) -> int:
        """For how many of the next steps nobody reads what the environments show: agent, adapter, or a display."""
        if self._display is not None:
            return 0
        return max(0, min(self._tap.unread, len(self._action_queue)))

    @property
    def _covered(self) -> int | None:
        """How many actions an observation covers; None for all, where nothing is corrected."""
        return None if self._corrector is None else self._corrector.chunk_size

    def _begin(self, batch_size: int) -> None:
        """Seed the draws of new episodes."""
        if not self._episodes.begin(batch_size):
            return
        self._plan = NOTHING
        first, seed = self._episodes.first, self.config.seed
        self._generators = spawn(seed, batch_size, first_episode=first, stream="editor")
        if self.perturbation is not None:
            self.perturbation.reset(batch_size, seed, first_episode=first)

    def _propose(self, proposal: Proposal) -> None:
        """Take a proposal of the agent; what was left of the last one is void."""
        raw = self._decode(proposal.actions)
        perturbed = None
        if self.perturbation is not None:
            healthy, raw = raw, self.perturbation(raw, self._step - self._plan.step)
            perturbed = (raw != healthy).flatten(1).any(dim=1)
        check_finite(raw, "the agent proposed", self._step)
        self._action_queue.clear()
        self._plan = Plan(raw, proposal.executed, self._step, perturbed)

    def _see(self, observation: dict[str, Any], batch_size: int) -> None:
        """What the environments show, at every step, unless the caller says which of them run."""
        if self._corrector is not None and self.running is None:
            self._journal.see(observation, batch_size)

    def _show(self, observation: dict[str, Any], proposed: Tensor, executed: Tensor) -> None:
        """Show proposed and executed actions (B, A) of a step, if there is a display."""
        if self._display is not None:
            known: dict[str, float] = {} if self.correction is None else self.correction.known
            self._display.show(observation, proposed, executed, known)

    def _correct(self, observation: dict[str, Any], window: Tensor) -> Tensor:
        """Correct proposed actions (B, n, A) that the observation covers: raw (B, n, A)."""
        if self._corrector is None:
            return window
        history = list(self._history)
        self._history.append(window)
        if self.running is not None and not self.running.any():
            return window
        # Whatever the editor keeps for its gradient must be made outside inference mode, and exactly.
        device = torch.device(self.config.device).type
        with torch.inference_mode(False), torch.no_grad(), torch.autocast(device, enabled=False):
            tensors = {key: value.clone() for key, value in observation.items() if isinstance(value, Tensor)}
            if self.running is None:
                correction = self._corrector(tensors, window.clone(), self._generators, history)
            else:
                rows = self.running
                some = {key: value[rows] for key, value in tensors.items()}
                generators = [self._generators[row] for row in rows.nonzero()[:, 0].tolist()]
                past = [before[rows] for before in history]
                correction = self._corrector(some, window[rows], generators, past).spread(window, rows)
        correction.action[correction.edited] = self._decode.snap(correction.action[correction.edited])
        self.correction = correction
        check_finite(correction.action, "the editor returned", self._step)
        self._journal.note(correction, self._episodes.first, self._step, self.running, self._plan.perturbed)
        return correction.action

    def predict_action_chunk(
        self,
        batch: dict[str, Any],
        inference_delay: int | None = None,
        prev_chunk_left_over: Tensor | None = None,
        **kwargs: Any,
    ) -> Tensor:
        """A raw chunk (B, n, A), for real-time chunking and other callers that queue by themselves.

        What the observation covers, at most the adapter's chunk size, is corrected as `select_action` corrects it. What
        lies further ahead passes as it was proposed: whoever executes it does so under observations that are to come.

        Args:
            batch: Raw observations.
            inference_delay: Steps that pass during inference, for an agent that supports real-time chunking.
            prev_chunk_left_over: What is left of the last chunk, as returned from here, (n, A), cut off or filled up by
                zeros as LeRobot does. It also says how many actions were executed since; without it, all were.
            **kwargs: Passed on to the agent.
        """
        self._tap.clear()
        self.correction = None
        prepared, left, ran = dict(batch), None, None
        if prev_chunk_left_over is not None:
            left = LeftOver.of(self._returned, prev_chunk_left_over)
            prepared["action"], ran = left.actions.to(self.config.device)[None], left.ran
        prepared = self._agent.preprocess(prepared)
        if left is not None:
            # Behind what is left stand the zeros that the agent would be given without a wrapper.
            kwargs["prev_chunk_left_over"] = F.pad(prepared.pop("action").squeeze(0), (0, 0, 0, left.padding))
        if inference_delay is not None:
            kwargs["inference_delay"] = inference_delay
        with torch.no_grad():
            chunk = self._tap.by_environment(self._agent.policy.predict_action_chunk(prepared, **kwargs))
            self._begin(chunk.shape[0])
            self._step = self._plan.step + (self._plan.executed if ran is None else ran)
            self._propose(Proposal(self._tap.whole(chunk), chunk.shape[1]))
            self._see(batch, chunk.shape[0])
            window, due = self._plan.take(self._covered)
            corrected = self._correct(batch, window)
            returned = torch.cat([corrected[:, :due], self._plan.actions[:, due : self._plan.executed]], dim=1)
        self._show(batch, window[:, 0], returned[:, 0])
        self._returned = returned[0].clone()  # whoever asks with a prefix asks for one environment
        return returned

    def supports_rtc(self) -> bool:
        return self._agent.policy.supports_rtc()

    def init_rtc_processor(self) -> None:
        """LeRobot sets `config.rtc_config` before it calls this; the agent must see it."""
        self._agent.policy.config.rtc_config = self.config.rtc_config
        if hasattr(self._agent.policy, "init_rtc_processor"):  # GR00T does without
            self._agent.policy.init_rtc_processor()

    def get_optim_params(self) -> dict:
        return self.config.get_optimizer_preset()

    def forward(self, batch: dict[str, Tensor], reduction: str = "mean") -> tuple[Tensor, dict | None]:
        return self.config.get_optimizer_preset()
