# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Threads that help with work in native code, and wait for it without Python.

To be woken takes a thread longer than an arm takes for a thousand states. A helper that has
finished therefore looks for more work for AWAKE seconds before it goes to sleep: in a loop that
calls a kernel it is there at once. Work lies in a mailbox, from which the helper takes it, or the
caller takes it back where he was faster alone.

    mailbox    64-bit integers: the address of a job or 0; whether somebody looks; jobs that were
               left again; jobs that were taken; whether to end; the address of its lock
    job        64-bit integers, of which number FUNCTION is the address of `void f(job, wait)`
"""

from __future__ import annotations

import atexit
import ctypes
from functools import cache
import os
import threading
import time
from typing import Any, ClassVar

import numpy as np

from pfd_core.kernels.conversion import address
from pfd_core.kernels.engine import compile_ir, host
from pfd_core.kernels.python_objects import DATA, load, python_function

# Seconds for which a helper looks for more work before it sleeps.
AWAKE = 1e-3
# Looks by which their duration is measured.
PROBE = 1000
# Seconds that a process waits for its helpers when it ends.
PATIENCE = 1.0
FUNCTION = 8
JOB, LOOKING, LEFT, TAKEN, END, LOCK, MAILBOX = range(7)
# How a processor is told that it waits; it computes nothing.
PAUSES = {
    'x86_64': ('declare void @llvm.x86.sse2.pause()', 'call void @llvm.x86.sse2.pause()'),
    'aarch64': ('declare void @llvm.aarch64.hint(i32)', 'call void @llvm.aarch64.hint(i32 1)'),
}


def helpers_ir(architecture: str) -> str:
    """
    Return what helpers and callers do to mailboxes.

    `void @look(mailbox, looks)` works on what it finds until it has looked so often in vain.
    `void @serve(mailbox, looks)` looks and sleeps until it is told to end.
    `void @post(mailbox, job)` hands over a job, and wakes the helper if it sleeps.
    `void @withdraw(mailbox, job)` takes it back, or counts it as taken.
    `@share(job, mailbox, ...)`, for Python, runs a job with some helpers.
    """
    declaration, pause = PAUSES.get(architecture, ('', ''))
    return f"""{declaration}
declare i32 @pfd.lock(ptr, i32)
declare void @pfd.unlock(ptr)
declare ptr @pfd.save()
declare void @pfd.restore(ptr)
declare void @pfd.incref(ptr)
@pfd.none = external global i8

define void @look(ptr %mailbox, i64 %patience) {{
entry:
  %left.at = getelementptr i64, ptr %mailbox, i64 {LEFT}
  br label %look
look:
  %looks = phi i64 [ 0, %entry ], [ %looks.next, %idle ], [ 0, %work ]
  %seen = load atomic i64, ptr %mailbox monotonic, align 8
  %some = icmp ne i64 %seen, 0
  br i1 %some, label %take, label %idle
take:
  %taken = atomicrmw xchg ptr %mailbox, i64 0 acquire
  %got = icmp ne i64 %taken, 0
  br i1 %got, label %work, label %idle
work:
  %job = inttoptr i64 %taken to ptr
  %function.at = getelementptr i64, ptr %job, i64 {FUNCTION}
  %function = load ptr, ptr %function.at
  call void %function(ptr %job, i64 0)
  %left = atomicrmw add ptr %left.at, i64 1 release
  br label %look
idle:
  {pause}
  %looks.next = add i64 %looks, 1
  %patient = icmp ult i64 %looks.next, %patience
  br i1 %patient, label %look, label %done
done:
  ret void
}}

define void @serve(ptr %mailbox, i64 %looks) {{
entry:
  %looking.at = getelementptr i64, ptr %mailbox, i64 {LOOKING}
  %end.at = getelementptr i64, ptr %mailbox, i64 {END}
  %lock.at = getelementptr i64, ptr %mailbox, i64 {LOCK}
  %lock = load ptr, ptr %lock.at
  br label %sleep
sleep:
  %woken = call i32 @pfd.lock(ptr %lock, i32 1)
  br label %rise
rise:
  call void @look(ptr %mailbox, i64 %looks)
  ; What is posted or told from here on is seen below, or finds the helper asleep, or both.
  %was = atomicrmw xchg ptr %looking.at, i64 0 seq_cst
  %told = load atomic i64, ptr %end.at seq_cst, align 8
  %over = icmp ne i64 %told, 0
  br i1 %over, label %done, label %check
check:
  %after = load atomic i64, ptr %mailbox seq_cst, align 8
  %again = icmp ne i64 %after, 0
  br i1 %again, label %alone, label %sleep
alone:
  %pair = cmpxchg ptr %looking.at, i64 0, i64 1 seq_cst seq_cst
  %mine = extractvalue {{ i64, i1 }} %pair, 1
  br i1 %mine, label %rise, label %sleep
done:
  ret void
}}

define void @post(ptr %mailbox, i64 %job) {{
entry:
  %before = atomicrmw xchg ptr %mailbox, i64 %job seq_cst
  %looking.at = getelementptr i64, ptr %mailbox, i64 {LOOKING}
  %pair = cmpxchg ptr %looking.at, i64 0, i64 1 seq_cst seq_cst
  %asleep = extractvalue {{ i64, i1 }} %pair, 1
  br i1 %asleep, label %wake, label %done
wake:
  %lock.at = getelementptr i64, ptr %mailbox, i64 {LOCK}
  %lock = load ptr, ptr %lock.at
  call void @pfd.unlock(ptr %lock)
  br label %done
done:
  ret void
}}

define void @withdraw(ptr %mailbox, i64 %job) {{
  %pair = cmpxchg ptr %mailbox, i64 %job, i64 0 seq_cst seq_cst
  %there = extractvalue {{ i64, i1 }} %pair, 1
  %taken.at = getelementptr i64, ptr %mailbox, i64 {TAKEN}
  %taken = load i64, ptr %taken.at
  %more = add i64 %taken, 1
  %now = select i1 %there, i64 %taken, i64 %more
  store i64 %now, ptr %taken.at
  ret void
}}

define ptr @share(ptr %self, ptr %args, i64 %count) {{
entry:
  %object = load ptr, ptr %args
{chr(10).join(load('job', '%object', DATA, 'ptr'))}
  %number = ptrtoint ptr %job to i64
  br label %post
{_each('post', 'entry', 'work')}
work:
  %function.at = getelementptr i64, ptr %job, i64 {FUNCTION}
  %function = load ptr, ptr %function.at
  %thread = call ptr @pfd.save()
  call void %function(ptr %job, i64 1)
  call void @pfd.restore(ptr %thread)
  br label %withdraw
{_each('withdraw', 'work', 'done')}
done:
  call void @pfd.incref(ptr @pfd.none)
  ret ptr @pfd.none
}}"""


def _each(name: str, before: str, after: str) -> str:
    """Return the blocks that call a function for the mailbox of each helper, and the job."""
    at = f'%{name}'
    return f"""{name}:
  {at}.k = phi i64 [ 1, %{before} ], [ {at}.next, {at}.one ]
  {at}.over = icmp uge i64 {at}.k, %count
  br i1 {at}.over, label %{after}, label {at}.one
{name}.one:
  {at}.at = getelementptr ptr, ptr %args, i64 {at}.k
  {at}.object = load ptr, ptr {at}.at
{chr(10).join(load(f'{name}.mailbox', f'{at}.object', DATA, 'ptr'))}
  call void @{name}(ptr {at}.mailbox, i64 %number)
  {at}.next = add i64 {at}.k, 1
  br label {at}"""


class _Mail:
    """The native functions, and how many looks take AWAKE seconds."""

    def __init__(self) -> None:
        native = compile_ir(helpers_ir(host().triple.split('-')[0]))
        with_number = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int64)
        self.serve, self.post, look = (
            with_number(native.address(name)) for name in ('serve', 'post', 'look')
        )
        self.share = python_function(native, 'share')
        empty = np.zeros(MAILBOX, np.int64)
        start = time.perf_counter()
        look(address(empty), PROBE)
        self.looks = max(int(AWAKE / (time.perf_counter() - start) * PROBE), 1)


@cache
def mail() -> _Mail:
    """Return what helpers run; compiled, or found on disk, when first asked for."""
    return _Mail()


class Helper(threading.Thread):
    """
    A thread that runs jobs, for one caller at a time.

    Attributes
    ----------
    mailbox : numpy.ndarray
        What `share` needs of it.

    """

    idle: ClassVar[list[Helper]] = []
    all: ClassVar[list[Helper]] = []
    starting: ClassVar[threading.Lock] = threading.Lock()

    def __init__(self) -> None:
        super().__init__(name='pfd', daemon=True)
        # A lock of Python's that native code may wait for, without the interpreter's.
        new, take = (
            ctypes.pythonapi.PyThread_allocate_lock,
            ctypes.pythonapi.PyThread_acquire_lock,
        )
        new.restype, take.argtypes = ctypes.c_void_p, [ctypes.c_void_p, ctypes.c_int]
        lock = new()
        take(lock, 1)
        self.mailbox = np.zeros(MAILBOX, np.int64)
        self.mailbox[LOCK] = lock
        self._kept: list[Any] = []
        self.start()

    def run(self) -> None:
        """Serve, without Python, until told to end."""
        mail().serve(address(self.mailbox), mail().looks)

    def keep(self, *what: Any) -> None:
        """Keep what must live for as long as a job is looked at, and forget what is over."""
        if self.mailbox[LEFT] == self.mailbox[TAKEN]:
            self._kept.clear()
        self._kept.append(what)

    @classmethod
    def some(cls, wanted: int, at_most: int) -> list[Helper]:
        """Return idle helpers, no more than wanted, and new ones up to `at_most` in all."""
        found: list[Helper] = []
        while len(found) < wanted:
            try:
                found.append(cls.idle.pop())
            except IndexError:
                with cls.starting:
                    if len(cls.all) >= at_most:
                        break
                    found.append(cls())
                    cls.all.append(found[-1])
        return found

    @classmethod
    def stop(cls) -> None:
        """End all: the code that they run is about to go."""
        for helper in cls.all:
            helper.mailbox[END] = 1
            mail().post(address(helper.mailbox), 0)
        for helper in cls.all:
            helper.join(PATIENCE)
        cls.forget()

    @classmethod
    def forget(cls) -> None:
        """Begin anew: a child process has none of its parent's threads."""
        cls.idle, cls.all, cls.starting = [], [], threading.Lock()


atexit.register(Helper.stop)
if hasattr(os, 'register_at_fork'):
    os.register_at_fork(after_in_child=Helper.forget)
