// Starts the page when all its parts are there.
"use strict";

show();
connect();
draw();
