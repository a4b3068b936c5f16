#include "check/models/flash_model.h"

#include <stddef.h>

#include "hal.h"

static flash_model_t *model;

/* 32 random bits (xorshift). */
static uint32_t draw_bits(flash_model_t *f)
{
    f->noise ^= f->noise << 13U;
    f->noise ^= f->noise >> 17U;
    f->noise ^= f->noise << 5U;
    return f->noise;
}

void flash_model_attach(flash_model_t *flash)
{
    model = flash;
}

/* Some of these bits: none, all, or any, by chance. */
static uint32_t draw_some(flash_model_t *f, uint32_t bits)
{
    const uint32_t how = draw_bits(f) % 4U;
    const uint32_t any = draw_bits(f);

    return bits & ((how == 0U) ? 0U : ((how == 1U) ? 0xFFFFFFFFU : any));
}

void flash_model_start(flash_model_t *flash)
{
    for (int32_t i = 0; i < (2 * flash->sector_words); i++) {
        const uint32_t weak = flash->weak[i];

        flash->words[i] = (flash->words[i] & ~weak) | ((weak != 0U) ? draw_some(flash, weak) : 0U);
    }
    flash->is_off = false;
}

/* Count an operation; return whether the power lasts through it. */
static bool lasts(flash_model_t *f)
{
    const bool cut = (f->cut_after >= 0) && (f->operations == (uint32_t)f->cut_after);

    f->operations++;
    f->is_off = f->is_off || cut;
    return !cut;
}

int32_t hal_flash_words(void)
{
    return (model != NULL) ? model->sector_words : 0;
}

uint32_t hal_flash_read(int32_t sector, int32_t word)
{
    return model->words[(sector * model->sector_words) + word];
}

bool hal_flash_program(int32_t sector, int32_t word, uint32_t value)
{
    const int32_t at = (sector * model->sector_words) + word;
    const uint32_t worn = (at == model->worn_word) ? model->worn_bits : 0U;
    const uint32_t after = model->words[at] & (value | worn);
    const uint32_t changing = (model->words[at] & ~after) | (model->weak[at] & ~value);
    bool done = false;

    if (!model->is_off) {
        if (lasts(model)) {
            model->words[at] = after;
            model->weak[at] &= ~changing;
            done = true;
        } else {
            model->weak[at] |= draw_some(model, changing);
            model->words[at] &= ~draw_some(model, changing);
        }
    }
    return done;
}

bool hal_flash_erase(int32_t sector)
{
    const int32_t first = sector * model->sector_words;
    bool done = false;

    if (!model->is_off) {
        done = lasts(model);
        for (int32_t i = first; (i < (first + model->sector_words)) && (sector != model->worn_sector); i++) {
            model->weak[i] = done ? 0U : draw_some(model, ~model->words[i] | model->weak[i]);
            model->words[i] |= done ? 0xFFFFFFFFU : draw_some(model, 0xFFFFFFFFU);
        }
    }
    return done;
}
