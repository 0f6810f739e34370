"""What a network saw: distances and ranges against what is known of the inputs."""

from __future__ import annotations

import torch

from gns_pl.graph.training_distribution import LEAST_SPREAD, QUANTILE, TrainingDistribution, surroundings


def normal(number: int = 20_000, seed: int = 0) -> torch.Tensor:
    """Two features that go together, and a third that is always the same [M, 3]."""
    first, own = torch.randn(2, number, generator=torch.Generator().manual_seed(seed))
    return torch.stack([1 + 2 * first, -3 + 0.5 * (0.9 * first + 0.1 * own), torch.full((number,), 0.577)], dim=1)


def test_one_in_a_hundred_inputs_of_training_is_farther_than_one() -> None:
    features = normal()
    seen = TrainingDistribution.of(features, ("a", "b", "c"))
    assert abs(float((seen.distance(features) > 1).float().mean()) - 0.01) < 1e-3
    fresh = seen.distance(normal(seed=1))
    assert abs(float((fresh > 1).float().mean()) - 0.01) < 5e-3


def test_the_mean_is_at_no_distance_and_distance_grows_in_proportion() -> None:
    seen = TrainingDistribution.of(normal(), ("a", "b", "c"))
    centre, away = seen.mean[None], torch.tensor([[1.0, 0.2, 0.0]])
    assert float(seen.distance(centre)) < 1e-6
    once, thrice = (float(seen.distance(centre + factor * away)) for factor in (1, 3))
    assert abs(thrice - 3 * once) < 1e-4 * thrice


def test_what_breaks_a_tie_is_farther_than_what_keeps_it() -> None:
    """Both features one deviation up is usual where they rise together; one up and one down is not."""
    seen = TrainingDistribution.of(normal(), ("a", "b", "c"))
    together, apart = (seen.mean + torch.tensor([2.0, sign * 0.45, 0.0]) for sign in (1, -1))
    assert float(seen.distance(apart[None])) > 3 * float(seen.distance(together[None]))
    assert not seen.outside(together[None]).any() and not seen.outside(apart[None]).any()


def test_ranges_leave_out_few_and_what_never_varied_has_some_room() -> None:
    features = normal()
    seen = TrainingDistribution.of(features, ("a", "b", "c"))
    outside = seen.outside(features).float().mean(dim=0)
    assert (outside[:2] < 2.5 * QUANTILE).all() and outside[2] == 0
    assert seen.spread[2] == LEAST_SPREAD
    near, far = (seen.mean + torch.tensor([0.0, 0.0, each]) for each in (0.5 * LEAST_SPREAD**2, 2 * LEAST_SPREAD))
    assert not seen.outside(near[None]).any()
    assert seen.outside(far[None]).tolist() == [[False, False, True]]


def test_units_of_a_feature_do_not_matter() -> None:
    features, scale = normal()[:, :2], torch.tensor([10.0, 0.4])
    plain, scaled = TrainingDistribution.of(features, ("a", "b")), TrainingDistribution.of(scale * features, ("a", "b"))
    some = normal(50, seed=2)[:, :2]
    torch.testing.assert_close(plain.distance(some), scaled.distance(scale * some), rtol=1e-4, atol=1e-4)


def test_a_summary_goes_through_a_checkpoint() -> None:
    seen = TrainingDistribution.of(normal(), ("a", "b", "c"), source="hash")
    again = TrainingDistribution.from_dict(seen.to_dict())
    assert again.names == ("a", "b", "c") and again.source == "hash" and again.usual == seen.usual
    some = normal(10, seed=3)
    assert torch.equal(again.distance(some), seen.distance(some))


def test_surroundings_of_a_row() -> None:
    """Three in a row at half a radius, the middle one moving; one that nobody is near has no relative speed."""
    position = torch.tensor([[0.0, 0.0], [0.5, 0.0], [1.0, 0.0], [9.0, 0.0]])
    velocity = torch.tensor([[0.0, 0.0], [0.0, 2.0], [0.0, 0.0], [5.0, 0.0]])
    edges = torch.tensor([[1, 0, 2, 1, 3], [0, 1, 1, 2, 3]])  # the last joins a particle to itself
    got = surroundings(position, velocity, edges, radius=1.0)
    expected = torch.tensor([[0.1, 0.5, 2.0], [0.2, 0.5, 2.0], [0.1, 0.5, 2.0], [0.0, 1.0, 0.0]])
    torch.testing.assert_close(got, expected)


def test_surroundings_do_not_see_a_common_motion() -> None:
    generator = torch.Generator().manual_seed(0)
    position, velocity = torch.rand(2, 12, 3, generator=generator)
    edges = torch.combinations(torch.arange(12)).T
    edges = torch.cat([edges, edges.flip(0)], dim=1)
    moved = surroundings(position + 3, velocity + torch.tensor([1.0, -2.0, 0.5]), edges, 0.4)
    torch.testing.assert_close(moved, surroundings(position, velocity, edges, 0.4), atol=1e-5, rtol=1e-5)
