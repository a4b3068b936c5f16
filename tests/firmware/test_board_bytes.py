"""Any bytes of a receiver and any contents of flash, with the sanitizers of the compiler, for some seconds."""

from __future__ import annotations

import shutil
import subprocess

import pytest

from mufly.firmware.export.source_export import copy_sources

HARNESS = r"""
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "check/models/flash_model.h"
#include "onboard/receiver/rc_frames.h"
#include "onboard/storage/storage.h"

#define WORDS 96

static uint32_t state = 1U;

static uint32_t draw(void)
{
    state ^= state << 13U;
    state ^= state >> 17U;
    state ^= state << 5U;
    return state;
}

static void check(bool right)
{
    if (!right) {
        abort();
    }
}

static void try_receiver(int32_t kind)
{
    static rc_decoder_t d;
    const uint8_t common[8] = {0xC8U, 0xEEU, 0x0FU, 0x18U, 0x16U, 0x14U, 0x00U, 0x04U};

    memset(&d, 0, sizeof d);
    d.kind = kind;
    for (int32_t n = 0; n < 3000; n++) {
        const uint32_t r = draw();

        (void)rc_decode(&d, ((r & 0x300U) == 0U) ? common[(r >> 10U) & 7U] : (uint8_t)(r & 0xFFU));
        check((d.length >= 0) && (d.length < RC_FRAME));
    }
}

static void try_flash(void)
{
    static uint32_t words[2 * WORDS], weak[2 * WORDS];
    static storage_t s;
    uint32_t payload[2 * WORDS];
    flash_model_t f = {.sector_words = WORDS, .words = words, .weak = weak, .cut_after = -1, .noise = draw() | 1U,
                       .worn_word = -1, .worn_sector = -1};

    for (int32_t i = 0; i < 2 * WORDS; i++) {
        words[i] = ((draw() & 3U) == 0U) ? draw() : 0xFFFFFFFFU;
        weak[i] = 0U;
        payload[i] = draw();
    }
    if ((draw() & 1U) != 0U) { /* a sector in use, with anything after its first words */
        words[0] = STORAGE_MAGIC;
        words[1] = STORAGE_LAYOUT;
        words[3] = draw() % 8U;
        words[4] = storage_crc(words, 4);
        words[5] = draw() & ((draw() & 1U) ? 0x00FF0103U : 0xFFFFFFFFU);
    }
    f.worn_word = ((draw() & 1U) != 0U) ? (int32_t)(draw() % (2U * WORDS)) : -1;
    f.worn_bits = draw();
    f.worn_sector = ((draw() & 3U) == 0U) ? (int32_t)(draw() & 1U) : -1;
    flash_model_attach(&f);
    for (int32_t n = 0; n < 12; n++) {
        f.cut_after = (int32_t)f.operations + (int32_t)(draw() % 200U);
        flash_model_start(&f);
        storage_open(&s);
        check((s.active >= -1) && (s.active < 2) && (s.end >= 0) && (s.end <= WORDS));
        for (int32_t k = 0; k < 8; k++) {
            (void)storage_write(&s, (int32_t)(draw() % 3U), draw() % 3U, payload, (int32_t)(draw() % 100U) - 1);
            (void)storage_read(&s, (int32_t)(draw() % 3U), 1U, payload, WORDS);
        }
    }
}

int main(void)
{
    for (int32_t n = 0; n < 400; n++) {
        try_receiver(1 + (n % 2));
        try_flash();
    }
    puts("sound");
    return 0;
}
"""
COMPILERS = [c for c in ("gcc", "clang") if shutil.which(c)]


@pytest.mark.skipif(not COMPILERS, reason="no C compiler: install gcc or clang")
def test_any_bytes_and_any_flash_are_borne(tmp_path) -> None:
    copy_sources(tmp_path)
    (tmp_path / "harness.c").write_text(HARNESS)
    sources = ["harness.c", "onboard/receiver/rc_frames.c", "onboard/storage/storage.c", "check/models/flash_model.c"]
    sanitizers = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    command = [*sanitizers, "-std=gnu99", "-O1", "-I.", *sources, "-o", "harness"]
    for cc in COMPILERS:
        built = subprocess.run([cc, *command], cwd=tmp_path, capture_output=True, text=True)
        if built.returncode == 0:
            break
    else:
        pytest.skip(f"no sanitizers: {built.stderr[-100:]}")
    done = subprocess.run([str(tmp_path / "harness")], capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stdout) == (0, "sound\n"), done.stderr[:2000]
