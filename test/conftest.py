# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What every test finds: a cache of compiled kernels of this run's own, empty at its start."""

from __future__ import annotations

from collections.abc import Iterator

import pytest


@pytest.fixture(scope='session', autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Leave the user's cache alone, also in the processes that tests start."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv('PFD_CACHE', str(tmp_path_factory.mktemp('cache')))
        yield
