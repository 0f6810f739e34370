"""What a data set and the settings of a training mean for each other: noise, reach, length of a pass.

Pure functions of the survey and the settings; `suggestions` judges the numbers, `advise` shows them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from gns_pl.data.survey_record import Survey
from gns_pl.models.config import SimulatorConfig
from gns_pl.training.config import TrainingConfig
from gns_pl.training.perturbation import Perturbation


@dataclass(frozen=True)
class Advice:
    """A survey and what follows from it for these settings.

    Attributes:
        survey: of the data set.
        model: of the network, with the data set's spacing and time step.
        training: conf/training.
        memory: of this machine [bytes].
        gravity: that the settings state [m/s²].
        reach: of the message passing, steps times radius [m].
        wave: how far a pressure wave goes in one step [m].
        noise_over_velocity: noise of the latest velocity over the data's standard deviation.
        noise_share: share of the one-step target's variance that is random-walk noise.
        restore_share: share of it that undoes coherent noise.
        strain_over_spacing: largest standard deviation of the coherent noise's displacement, in spacings.
        windows: listed in a pass, repeated ones included; estimated.
        cold_start_share: estimated share of these in which a body sets out from rest.
        steps_per_pass: training steps for a pass.
        passes: in the whole training.
        edges: estimated, of one window's graph, both directions.
    """

    survey: Survey
    model: SimulatorConfig
    training: TrainingConfig
    memory: float
    gravity: float
    reach: float
    wave: float
    noise_over_velocity: float
    noise_share: float
    restore_share: float
    strain_over_spacing: float
    windows: int
    cold_start_share: float
    steps_per_pass: int
    passes: float
    edges: float


def compute_advice(
    survey: Survey, model: SimulatorConfig, training: TrainingConfig, *, memory: float, gravity: float
) -> Advice:
    """Return what follows from a survey for the settings.

    Args:
        survey: of the data set.
        model: with the data set's spacing and time step.
        training: conf/training.
        memory: of this machine [bytes].
        gravity: that the settings state [m/s²].
    """
    motion, sizes, starts = survey.motion, survey.sizes, survey.starts
    perturbation = training.perturbation
    walk, coherent = target_noise(perturbation, model.input_sequence_length)
    variance = walk + coherent + (motion.acceleration_std * motion.dt**2) ** 2
    shown = training.moving_repeats  # of what moves; bodies that set out do
    early = motion.setting_out
    out = training.start_repeats * shown * early
    later = (1 - early) + (shown - 1) * max(0.0, motion.frames_moving - early)
    windows = round(sizes.num_windows * (out + later))
    step_length = motion.velocity_std * motion.dt
    return Advice(
        survey=survey,
        model=model,
        training=training,
        memory=memory,
        gravity=gravity,
        reach=model.num_message_passing_steps * model.connectivity_radius,
        wave=starts.p_wave_speed * motion.dt,
        noise_over_velocity=perturbation.noise_std / step_length if step_length else math.inf,
        noise_share=walk / variance if variance else 0.0,
        restore_share=coherent / variance if variance else 0.0,
        strain_over_spacing=perturbation.strain_std * perturbation.strain_length / survey.density.spacing,
        windows=windows,
        cold_start_share=out / (out + later) * starts.num_cold / starts.num_seen,
        steps_per_pass=math.ceil(windows / training.batch_size),
        passes=training.optimisation.num_steps * training.batch_size / windows,
        edges=sizes.particles_mean * survey.density.neighbours[0],
    )


def target_noise(perturbation: Perturbation, input_sequence_length: int) -> tuple[float, float]:
    """Return the noise's part of the variance of one component of Δt² times the target [m²].

    The target leads from the perturbed history to x_{t+1} + (1 − κ) n_t, so that noise enters it as
    −(n_t − n_{t−1}) − κ n_t. With the S = H − 1 independent increments w of variance σ²/S, n_t − n_{t−1} is their sum
    and n_t = Σ m w_{S+1−m}, m from 1 to S. The coherent displacement is the same in the whole history, so only κ shows
    it; its level is uniform from 0 on, which leaves a third of its variance.

    Args:
        perturbation: how histories are perturbed.
        input_sequence_length: H.

    Returns:
        That of the random walk, and that of the coherent noise.
    """
    steps, restore = input_sequence_length - 1, perturbation.restore
    walk = perturbation.noise_std**2 / steps * sum((1 + restore * m) ** 2 for m in range(1, steps + 1))
    coherent = (restore * perturbation.strain_std * perturbation.strain_length) ** 2 / 3
    noisy = 1 - perturbation.noise_free
    return noisy * walk, noisy * coherent
