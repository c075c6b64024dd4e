#include "iris/core/memory.h"

#include <cstdlib>  // says whether it is of glibc

#ifdef __GLIBC__
#include <malloc.h>
#endif

namespace iris {

void keep_freed_memory() {
#ifdef __GLIBC__
  // From its own defaults, 128 KiB each, it moves only by and by, and by different amounts in every thread's part.
  mallopt(M_MMAP_THRESHOLD, 32 << 20);
  mallopt(M_TRIM_THRESHOLD, 256 << 20);
#endif
}

}  // namespace iris
