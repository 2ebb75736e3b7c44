/* One core for all who compute by turns; see core.c. */
#ifndef CORE_H
#define CORE_H

#include <stdbool.h>

/* Have this thread, which may be on any core, stay on one; -1 gives it back all that it had. */
void core_stay_on(int core);

/* The core that this thread stays on; -1 for none. */
int core_kept(void);

/* Whether threads have come since this one has stayed on a core: they have inherited that. */
bool core_has_been_inherited(void);

#endif
