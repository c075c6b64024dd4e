#include "export/html.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace iris::exporters::html {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

TEST(Html, NamesCannotBecomeMarkup) {
  EXPECT_EQ(escape("a < b & \"c\" > d"), "a &lt; b &amp; &quot;c&quot; &gt; d");
  const std::string name = "<script>alert(1)</script>";
  for (const std::string& text : {page(name, "<p>body</p>"), figure(name, name), details(name, "<p>body</p>")}) {
    EXPECT_THAT(text, Not(HasSubstr("<script>")));
    EXPECT_THAT(text, HasSubstr("&lt;script&gt;"));
  }
}

TEST(Html, APageHoldsItsBody) {
  EXPECT_THAT(page("title", "<p>body &amp; soul</p>"), HasSubstr("<h1>title</h1>\n<p>body &amp; soul</p>"));
}

}  // namespace
}  // namespace iris::exporters::html
