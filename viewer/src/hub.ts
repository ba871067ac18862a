// Starts the page of a hub.

import { mount } from "svelte";
import "./theme.css";
import Hub from "./Hub.svelte";

mount(Hub, { target: document.getElementById("app")! });
