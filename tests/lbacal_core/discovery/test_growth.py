from __future__ import annotations

from lbacal_core.discovery.growth import grow


class Letters:
    """Models are words: every letter but those refused may be added, in the order of the alphabet given."""

    def __init__(self, alphabet, refused=""):
        self.alphabet, self.refused, self.tested = alphabet, refused, []

    def propose(self, before):
        return [before + letter for letter in self.alphabet if letter not in before]

    def model_of(self, candidate):
        return candidate

    def held_out_gain(self, before, candidate):
        self.tested.append((before, candidate))
        return 0.0 if candidate[-1] in self.refused else 1.5


def test_a_model_grows_by_the_best_candidate_until_nothing_is_proposed():
    steps = grow("", Letters("ab"), 5)
    assert [step.candidate for step in steps] == ["a", "ab"]
    assert [step.held_out_gain for step in steps] == [1.5, 1.5]


def test_a_candidate_that_held_out_data_refuse_gives_way_to_the_next_one():
    search = Letters("abc", refused="a")
    assert [step.candidate for step in grow("", search, 5)] == ["b", "bc"]
    # Those behind the one accepted are not tested, and what is refused is asked again of the larger model.
    assert search.tested == [("", "a"), ("", "b"), ("b", "ba"), ("b", "bc"), ("bc", "bca")]


def test_a_model_takes_no_more_causes_than_are_allowed():
    assert [step.candidate for step in grow("", Letters("abcd"), 2)] == ["a", "ab"]
