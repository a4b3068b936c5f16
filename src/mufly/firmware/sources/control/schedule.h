/* Whether roll-pitch is scheduled over forward speed; the export of a scheduled design writes 1. */
#ifndef MUFLY_SCHEDULE_H
#define MUFLY_SCHEDULE_H

#define ROLL_PITCH_SCHEDULED 0

#endif
