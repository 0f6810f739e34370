from __future__ import annotations

import itertools

import pytest

from gns_pl.data.sampler import POOL, StepSampler


def test_every_window_once_per_pass_in_a_new_order() -> None:
    batches = list(StepSampler(num_windows=12, batch_size=3, num_steps=8, seed=1))
    first, second = [d.window for b in batches[:4] for d in b], [d.window for b in batches[4:] for d in b]
    assert sorted(first) == sorted(second) == list(range(12))
    assert first != second


def test_batches_may_straddle_passes() -> None:
    indices = [d.window for batch in StepSampler(num_windows=5, batch_size=2, num_steps=5, seed=0) for d in batch]
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
    assert [drawn.number for batch in joined for drawn in batch] == list(range(30))
    assert not any(drawn.visit for batch in joined for drawn in batch)


def test_the_batch_of_a_step_is_had_without_those_before_it() -> None:
    settings = {"num_windows": 7, "batch_size": 3, "num_steps": 9, "seed": 2}
    assert StepSampler(**settings).joined_batch(6) == list(StepSampler(**settings))[6]
    with pytest.raises(ValueError, match="3 windows cannot be shared by 2"):
        StepSampler(**settings, num_ranks=2)


VISITED = {"num_windows": 500, "batch_size": 4, "num_steps": 12 * POOL, "seed": 5, "visits": 5}


def test_a_window_is_visited_in_order_and_at_equal_distances() -> None:
    met: dict[int, list[tuple[int, int, int]]] = {}
    for step, batch in enumerate(StepSampler(**VISITED)):
        for drawn in batch:
            met.setdefault(drawn.number, []).append((step, drawn.visit, drawn.window))
    whole = [visits for visits in met.values() if visits[0][1] == 0 and visits[0][0] < 7 * POOL]
    assert len(whole) > POOL
    for visits in whole:
        assert [visit for _, visit, _ in visits] == list(range(5))
        assert {later[0] - step[0] for step, later in itertools.pairwise(visits)} == {POOL}
        assert len({index for *_, index in visits}) == 1
    indices = [visits[0][2] for number, visits in met.items() if number < VISITED["num_windows"]]
    assert len(set(indices)) == len(indices)  # a pass shows no window to two numbers


def test_young_and_old_windows_come_at_the_same_time() -> None:
    """Or the whole training would swing between the beginnings and the ends of what is followed."""
    steps = list(StepSampler(**VISITED))
    for first in range(0, len(steps) - POOL, POOL):
        ages = [drawn.visit for batch in steps[first : first + POOL] for drawn in batch]
        assert all(ages.count(age) >= POOL * 4 // 5 - 4 for age in range(5))


@pytest.mark.parametrize("num_ranks", [2, 4])
def test_a_window_stays_with_its_process(num_ranks: int) -> None:
    samplers = [StepSampler(**VISITED, rank=rank, num_ranks=num_ranks) for rank in range(num_ranks)]
    for rank, sampler in enumerate(samplers):
        assert {sampler.rank_of(drawn.number) for batch in sampler for drawn in batch} == {rank}
