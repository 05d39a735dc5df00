/* What the library says of itself. */
#include "lab.h"

#ifndef HYSTMPC_DIGEST
#define HYSTMPC_DIGEST "unknown"
#endif

const char *hystmpc_digest(void) { return HYSTMPC_DIGEST; }
