// The report of a run: one page that shows what was made and says how good it is.
#pragma once

#include "iris/core/options.h"
#include "iris/workspace/workspace.h"

namespace iris::exporters {

// Writes into OUT/report: index.html, which opens in any browser without network and refers to the other products by
// their place in OUT; plots of the motions and of the path's stated errors; pictures of three stored views. Needs the
// stage "loop"; of the products it shows those that are there. `options`: those of the run; the ones that are not the
// default are listed. The same output gives the same bytes. Throws InputError if a file cannot be written.
void write_report(const workspace::Workspace& workspace, const OptionSet& options);

}  // namespace iris::exporters
