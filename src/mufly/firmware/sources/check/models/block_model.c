#include "check/models/block_model.h"

#include <stddef.h>

static block_model_t *model;

void block_model_attach(block_model_t *device)
{
    model = device;
}

void block_model_start(block_model_t *device)
{
    device->cached_count = 0;
    device->polls_left = 0;
    device->is_off = false;
}

int32_t hal_block_count(void)
{
    return (model != NULL) ? model->blocks : 0;
}

static uint32_t draw_bits(block_model_t *m)
{
    m->noise ^= m->noise << 13U;
    m->noise ^= m->noise >> 17U;
    m->noise ^= m->noise << 5U;
    return m->noise;
}

static void store(block_model_t *m, int32_t block, const uint32_t from[BLOCK_WORDS], int32_t count)
{
    const uint8_t wear = (m->worn != NULL) ? m->worn[block] : 0U;

    for (int32_t i = 0; (wear == 0U) && (i < count); i++) {
        m->words[(block * BLOCK_WORDS) + i] = from[i];
    }
}

/* Begin an operation; return whether the power lasts through it. */
static bool lasts(block_model_t *m)
{
    const bool cut = (m->cut_after >= 0) && (m->operations == (uint32_t)m->cut_after);

    m->operations++;
    m->is_off = m->is_off || cut;
    m->polls_left = m->write_polls;
    m->answer = (int32_t)BLOCK_DONE;
    return !cut;
}

static bool accepts(block_model_t *m, int32_t block)
{
    const bool is_inside = (m != NULL) && (block >= 0) && (block < m->blocks);

    if (!is_inside && (m != NULL)) {
        m->outside++;
    }
    return is_inside && !m->is_off && !m->refuses;
}

bool hal_block_read(int32_t block, uint32_t to[BLOCK_WORDS])
{
    const bool works = accepts(model, block);

    if (works) {
        const uint32_t *from = &model->words[block * BLOCK_WORDS];

        for (int32_t k = 0; k < model->cached_count; k++) {
            from = (model->cached_block[k] == block) ? model->cached[k] : from;
        }
        for (int32_t i = 0; i < BLOCK_WORDS; i++) {
            to[i] = from[i];
        }
        model->polls_left = 0;
        model->answer = (int32_t)BLOCK_DONE;
    }
    return works;
}

/* Give some of the cached blocks, in any order, or all to the medium. */
static void empty_cache(block_model_t *m, bool all)
{
    for (int32_t k = 0; k < m->cached_count; k++) {
        if (all || ((draw_bits(m) & 1U) != 0U)) {
            store(m, m->cached_block[k], m->cached[k], BLOCK_WORDS);
        }
    }
    m->cached_count = 0;
}

bool hal_block_write(int32_t block, const uint32_t from[BLOCK_WORDS])
{
    const bool works = accepts(model, block);

    if (works) {
        const bool whole = lasts(model);

        if (!whole) {
            empty_cache(model, false);
            store(model, block, from, (int32_t)(draw_bits(model) % (uint32_t)(BLOCK_WORDS + 1)));
        } else if (model->caches) {
            if (model->cached_count == MODEL_CACHE) {
                empty_cache(model, true);
            }
            for (int32_t i = 0; i < BLOCK_WORDS; i++) {
                model->cached[model->cached_count][i] = from[i];
            }
            model->cached_block[model->cached_count] = block;
            model->cached_count++;
        } else {
            store(model, block, from, BLOCK_WORDS);
        }
        if ((model->worn != NULL) && (model->worn[block] == 2U)) {
            model->answer = (int32_t)BLOCK_ERROR;
        }
    }
    return works;
}

bool hal_block_flush(void)
{
    const bool works = accepts(model, 0);

    if (works) {
        empty_cache(model, lasts(model));
    }
    return works;
}

int32_t hal_block_poll(void)
{
    int32_t answer = (int32_t)BLOCK_BUSY;

    if ((model != NULL) && !model->is_silent && !model->is_off) {
        answer = (model->polls_left > 0) ? (int32_t)BLOCK_BUSY : model->answer;
        model->polls_left -= (model->polls_left > 0) ? 1 : 0;
    }
    return answer;
}
