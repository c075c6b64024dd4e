// Memory of the process.
#pragma once

namespace iris {

// For programs that work on one image after the other: what one has freed, the next one needs again. The process keeps
// up to 256 MB of it, where the C library by itself returns large blocks to the system, which has to clear them and map
// them in anew: a ninth of the time of stereo. Call it once, before threads are started. Without effect on C libraries
// other than glibc.
void keep_freed_memory();

}  // namespace iris
