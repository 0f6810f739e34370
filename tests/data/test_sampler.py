from __future__ import annotations

from gns_pl.data.sampler import StepSampler


def test_every_window_once_per_pass_in_a_new_order() -> None:
    batches = list(StepSampler(num_windows=12, batch_size=3, num_steps=8, seed=1))
    first, second = [i for b in batches[:4] for i in b], [i for b in batches[4:] for i in b]
    assert sorted(first) == sorted(second) == list(range(12))
    assert first != second


def test_batches_may_straddle_passes() -> None:
    indices = [i for batch in StepSampler(num_windows=5, batch_size=2, num_steps=5, seed=0) for i in batch]
    assert sorted(indices[:5]) == sorted(indices[5:]) == list(range(5))


def test_going_on_gives_the_same_batches() -> None:
    whole = list(StepSampler(num_windows=7, batch_size=2, num_steps=20, seed=3))
    rest = list(StepSampler(num_windows=7, batch_size=2, num_steps=20, seed=3, first_step=9))
    assert rest == whole[9:]


def test_the_seed_matters() -> None:
    assert list(StepSampler(num_windows=50, batch_size=5, num_steps=4, seed=1)) != list(
        StepSampler(num_windows=50, batch_size=5, num_steps=4, seed=2)
    )
