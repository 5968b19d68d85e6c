import numpy as np
import pytest

from tiegraph.scene.sorting import order_of, row_numbers, run_starts


@pytest.mark.parametrize("most", [10, 2**40])
def test_order_is_stable(most):
    numbers = np.random.default_rng(0).integers(0, most, 1000)
    order = order_of(numbers)
    np.testing.assert_array_equal(order, np.argsort(numbers, kind="stable"))
    np.testing.assert_array_equal(numbers[order][run_starts(numbers[order])], np.unique(numbers))


def test_nothing_to_sort():
    assert len(order_of(np.zeros(0, int))) == len(run_starts(np.zeros(0, int))) == 0


@pytest.mark.parametrize("wide", [5, 2**30])
def test_equal_columns_have_equal_numbers(wide):
    columns = np.random.default_rng(0).integers(-wide, wide, (3, 200))
    columns[:, 100:] = columns[:, :100]
    numbers = row_numbers(columns)
    assert numbers.min() >= 0
    np.testing.assert_array_equal(numbers[:100], numbers[100:])
    np.testing.assert_array_equal(np.argsort(numbers[:100], kind="stable"), np.lexsort(columns[::-1, :100]))
