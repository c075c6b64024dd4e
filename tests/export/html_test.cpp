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

// The examples of RFC 4648.
TEST(Html, BytesAsBase64) {
  const unsigned char bytes[] = {'f', 'o', 'o', 'b', 'a', 'r'};
  const char* expected[] = {"", "Zg==", "Zm8=", "Zm9v", "Zm9vYg==", "Zm9vYmE=", "Zm9vYmFy"};
  for (size_t n = 0; n <= 6; ++n) EXPECT_EQ(base64({bytes, n}), expected[n]);
}

TEST(Html, APageHoldsItsBody) {
  EXPECT_THAT(page("title", "<p>body &amp; soul</p>"), HasSubstr("<h1>title</h1>\n<p>body &amp; soul</p>"));
}

}  // namespace
}  // namespace iris::exporters::html
