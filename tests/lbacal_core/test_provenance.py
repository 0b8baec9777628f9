from __future__ import annotations

import hashlib
from importlib.metadata import version

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lbacal_core.provenance import MODEL_VERSION, Provenance, canonical_json, hash_arrays, hash_content

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=12,
)


@pytest.mark.long
@given(content=st.dictionaries(st.text(), JSON, min_size=2, max_size=5))
def test_the_order_of_fields_does_not_change_a_hash(content: dict[str, object]) -> None:
    assert hash_content(dict(reversed(content.items()))) == hash_content(content)


def test_the_hash_of_content_is_that_of_its_canonical_json() -> None:
    assert canonical_json({"b": [1, 2.5], "a": "é"}) == '{"a":"é","b":[1,2.5]}'
    assert hash_content({"a": 1}) == hashlib.sha256(b'{"a":1}').hexdigest()


def test_nan_has_no_hash() -> None:
    with pytest.raises(ValueError, match="JSON compliant"):
        hash_content({"a": float("nan")})


def test_arrays_hash_alike_whatever_their_byte_order_and_memory_layout() -> None:
    values = np.arange(12.0).reshape(3, 4)
    expected = hash_arrays(values)
    assert hash_arrays(values.astype(">f8")) == expected
    assert hash_arrays(np.asfortranarray(values)) == expected
    assert hash_arrays(np.array(["a", "bc"])) == hash_arrays(np.array(["a", "bc"], dtype="U20"))


def test_arrays_that_differ_in_value_shape_type_or_division_hash_differently() -> None:
    values = np.arange(12.0)
    others = [
        (np.nextafter(values, 99),),
        (values.reshape(3, 4),),
        (values.astype("f4"),),
        (values[:6], values[6:]),
        (np.array(["a", "b"]),),
        (np.array(["ab"]),),
        (np.array(["a"]), np.array(["b"])),
    ]
    hashes = {hash_arrays(values), *(hash_arrays(*arrays) for arrays in others)}
    assert len(hashes) == len(others) + 1


def test_provenance_names_inputs_settings_and_versions() -> None:
    provenance = Provenance({"spectra": "ab"}, {"scope": "station"})
    assert provenance.as_dict() == {
        "inputs": {"spectra": "ab"},
        "settings": {"scope": "station"},
        "model_version": MODEL_VERSION,
        "lbacal": version("lbacal"),
    }
