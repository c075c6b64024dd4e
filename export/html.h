// Pages that open in any browser, without network.
#pragma once

#include <span>
#include <string>
#include <string_view>

namespace iris::exporters::html {

// Text as it stands in a page or in an attribute.
std::string escape(std::string_view text);

// Bytes as they stand in a data: address (RFC 4648).
std::string base64(std::span<const unsigned char> bytes);

// The frame of every page. `title` is text, `head` (styles, scripts) and `body` are HTML.
std::string document(std::string_view title, std::string_view head, std::string_view body);

// A whole page with the project's style. `title` is text, `body` is HTML.
std::string page(std::string_view title, std::string_view body);

// A picture with a caption below; it opens alone when clicked. `source` as a link, `caption` is text.
std::string figure(std::string_view source, std::string_view caption);

// Something long that shows when its title is clicked. `title` is text, `body` is HTML.
std::string details(std::string_view title, std::string_view body);

}  // namespace iris::exporters::html
