"""What every test runs under: offline, one thread, rendering without a display."""

import os

# Before torch and huggingface_hub are imported, which read them once. `make test` sets them too.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("HF_HUB_OFFLINE", "1")
os.environ.setdefault("MUJOCO_GL", "egl")

import torch

torch.set_num_threads(1)
