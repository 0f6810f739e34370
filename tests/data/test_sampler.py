from __future__ import annotations

import pytest

from gns_pl.data.sampler import StepSampler


def test_every_window_once_per_pass_in_a_new_order() -> None:
    batches = list(StepSampler(num_windows=12, batch_size=3, num_steps=8, seed=1))
    first, second = [i for b in batches[:4] for i, _ in b], [i for b in batches[4:] for i, _ in b]
    assert sorted(first) == sorted(second) == list(range(12))
    assert first != second


def test_batches_may_straddle_passes() -> None:
    indices = [i for batch in StepSampler(num_windows=5, batch_size=2, num_steps=5, seed=0) for i, _ in batch]
    assert sorted(indices[:5]) == sorted(indices[5:]) == list(range(5))


def test_going_on_gives_the_same_batches() -> None:
    whole = list(StepSampler(num_windows=7, batch_size=2, num_steps=20, seed=3))
    rest = list(StepSampler(num_windows=7, batch_size=2, num_steps=20, seed=3, first_step=9))
    assert rest == whole[9:]


def test_the_seed_matters() -> None:
    assert list(StepSampler(num_windows=50, batch_size=5, num_steps=4, seed=1)) != list(
        StepSampler(num_windows=50, batch_size=5, num_steps=4, seed=2)
    )


@pytest.mark.parametrize("num_ranks", [1, 2, 3, 6])
def test_processes_share_the_joined_batch_and_its_numbers(num_ranks: int) -> None:
    settings = {"num_windows": 11, "batch_size": 6, "num_steps": 5, "seed": 4}
    shares = [list(StepSampler(**settings, rank=rank, num_ranks=num_ranks)) for rank in range(num_ranks)]
    joined = [[drawn for share in shares for drawn in share[step]] for step in range(5)]
    assert joined == list(StepSampler(**settings))
    assert [number for batch in joined for _, number in batch] == list(range(30))


def test_the_batch_of_a_step_is_had_without_those_before_it() -> None:
    settings = {"num_windows": 7, "batch_size": 3, "num_steps": 9, "seed": 2}
    assert StepSampler(**settings).joined_batch(6) == list(StepSampler(**settings))[6]
    with pytest.raises(ValueError, match="3 windows cannot be shared by 2"):
        StepSampler(**settings, num_ranks=2)
