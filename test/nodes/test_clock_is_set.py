"""The system's clock is set while real nodes push a joint: threads of the middleware that wait on it must not stand still."""

from __future__ import annotations

import shutil
import subprocess
import time
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

from support.domains import free_domain
from support.live import running, wait_for
from support.pushes import AWAY, one_push

pytestmark = pytest.mark.long

SHIM = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/time.h>
#include <time.h>

static volatile const long *offset_s;

__attribute__((constructor)) static void map_offset(void) {
    int file = open(getenv("TEST_CLOCK_OFFSET"), O_RDONLY);
    offset_s = mmap(0, sizeof *offset_s, PROT_READ, MAP_SHARED, file, 0);
}

/* the newest of the functions of that name, where a library has several */
static void *next(const char *name, const char *version) {
    void *found = dlvsym(RTLD_NEXT, name, version);
    return found ? found : dlsym(RTLD_NEXT, name);
}

int clock_gettime(clockid_t clock, struct timespec *now) {
    static int (*real)(clockid_t, struct timespec *);
    if (!real) real = (int (*)(clockid_t, struct timespec *))next("clock_gettime", "GLIBC_2.17");
    int result = real(clock, now);
    if (clock == CLOCK_REALTIME && offset_s) now->tv_sec += *offset_s;
    return result;
}

int gettimeofday(struct timeval *now, void *zone) {
    struct timespec precise;
    (void)zone;
    clock_gettime(CLOCK_REALTIME, &precise);
    now->tv_sec = precise.tv_sec;
    now->tv_usec = precise.tv_nsec / 1000;
    return 0;
}

/* The kernel's clock stays: deadlines on the system's clock have to be told to it in its own time. Those on the monotonic
   clock are smaller than any date. */
static struct timespec kernel_time(const struct timespec *deadline) {
    struct timespec translated = *deadline;
    if (offset_s && deadline->tv_sec > 1000000000) translated.tv_sec -= *offset_s;
    return translated;
}

int pthread_cond_timedwait(pthread_cond_t *condition, pthread_mutex_t *mutex, const struct timespec *deadline) {
    static int (*real)(pthread_cond_t *, pthread_mutex_t *, const struct timespec *);
    if (!real)
        real = (int (*)(pthread_cond_t *, pthread_mutex_t *, const struct timespec *))next("pthread_cond_timedwait", "GLIBC_2.3.2");
    struct timespec translated = kernel_time(deadline);
    return real(condition, mutex, &translated);
}

int pthread_mutex_timedlock(pthread_mutex_t *mutex, const struct timespec *deadline) {
    static int (*real)(pthread_mutex_t *, const struct timespec *);
    if (!real) real = (int (*)(pthread_mutex_t *, const struct timespec *))next("pthread_mutex_timedlock", "GLIBC_2.34");
    struct timespec translated = kernel_time(deadline);
    return real(mutex, &translated);
}

int sem_timedwait(sem_t *semaphore, const struct timespec *deadline) {
    static int (*real)(sem_t *, const struct timespec *);
    if (!real) real = (int (*)(sem_t *, const struct timespec *))next("sem_timedwait", "GLIBC_2.34");
    struct timespec translated = kernel_time(deadline);
    return real(semaphore, &translated);
}
"""


@pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc")
def test_the_clock_is_set_in_mid_probe(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", free_domain())
    offset = tmp_path / "offset"
    offset.write_bytes(
        (0).to_bytes(
            8,
            "little",
            signed=True,
        )
    )
    source = tmp_path / "shim.c"
    library = tmp_path / "shim.so"
    probe = tmp_path / "push.yaml"
    source.write_text(SHIM)
    probe.write_text(one_push(-0.28, 2.0, AWAY))
    subprocess.run(
        [
            "gcc",
            "-shared",
            "-fPIC",
            "-O1",
            "-o",
            library,
            source,
            "-ldl",
        ],
        check=True,
        timeout=60,
    )
    environment = {"LD_PRELOAD": str(library), "TEST_CLOCK_OFFSET": str(offset)}
    # a computer's clock is that of all nodes
    nodes = ("virtual", "driver", "excitation")
    with running(
        tmp_path, *nodes, environment=environment, excitation={"probe": probe, "stale_after": 4.0},
        driver={"reply_timeout": 0.1, "command_timeout": 0.5},
    ) as (graph, client):  # fmt: skip
        for jumped_s in (10, -10):
            assert wait_for(lambda: client.excitation["joint_states"] == "true")
            assert client.call("/excitation/run").success
            client.wait_for_phase("probe")
            with offset.open("r+b") as file:  # in place: the file is mapped
                file.write(
                    jumped_s.to_bytes(
                        8,
                        "little",
                        signed=True,
                    )
                )
            client.wait_for_phase("done")
            said = f"the system's clock was set by {'' if jumped_s > 0 else '-'}"
            assert wait_for(lambda said=said: said in graph.log("driver")), graph.log("driver")

            def follows(jumped_s: int = jumped_s) -> bool:
                stamp = client.states[-1].header.stamp
                return abs(stamp.sec - time.time() - jumped_s) < 5.0

            assert wait_for(follows), "stamps follow it then"
